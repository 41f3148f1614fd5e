"""The reason codes of findings, verdicts and refusals, each with its meaning, usual cause, and remedy.

`imucal help CODE` prints the entry of a code, and the page docs/codes.md lists all entries.
"""

from __future__ import annotations

import re
from typing import Final, NamedTuple

__all__ = ["CODES", "Code", "code_text", "codes_markdown", "kind_of"]


class Code(NamedTuple):
    """Usual cause of a reason code, and the remedy that usually helps."""

    cause: str
    cure: str


# Codes by heading of their group.
CODES: Final[dict[str, dict[str, Code]]] = {
    "The recording cannot be used as it is": {
        "not_enough_motion": Code(
            cause="The motion does not determine every parameter.",
            cure=(
                "Add the poses that the message names, or estimate [a smaller model](few-poses.md) with "
                "`--model`."
            ),
        ),
        "fit_failed": Code(
            cause="The fit failed: it did not converge to an acceptable result.",
            cure="Look at the recording with `imucal inspect`.",
        ),
        "empty": Code(
            cause="The recording has no sample.",
            cure="Check that the file was written to its end.",
        ),
        "lengths_differ": Code(
            cause="The arrays for time, specific force and angular rate have different lengths.",
            cure="Pass arrays that all have one row per sample.",
        ),
        "too_short": Code(
            cause="The recording has too few samples or is too short for rests in several poses.",
            cure="Record rests in many poses with moves between them; some minutes are enough.",
        ),
        "sensor_missing": Code(
            cause="The file has no columns of one sensor, but the command needs both sensors.",
            cure="Name the columns with `--columns`, or calibrate [one sensor](one-sensor.md).",
        ),
        "non_finite": Code(
            cause="A sample is not a number (NaN or infinite).",
            cure="Remove these rows, or find out why the logger wrote them.",
        ),
        "value_impossible": Code(
            cause=(
                "A sample is larger than any such sensor can measure, for example because a line of the file "
                "is damaged."
            ),
            cure="Remove these rows, or give the unit of the column in its name.",
        ),
        "stuck_axis": Code(
            cause="An axis has a constant value while the other axes change.",
            cure=(
                "Check the wiring, the order of the columns and the axis enable bits of the sensor. A "
                "warning may be ignored if the motion does not excite this axis."
            ),
        ),
        "columns_identical": Code(
            cause=(
                "Two columns have the same value in every sample, because a column was written or named "
                "twice."
            ),
            cure=(
                "Correct the program that writes the file, or the names of the columns. Other motion does "
                "not help."
            ),
        ),
        "accel_saturation": Code(
            cause="Samples of the accelerometer are at the end of its measurement range.",
            cure=(
                "Choose a larger range or move more gently; `--exclude-saturated` leaves out the affected "
                "rests and moves."
            ),
        ),
        "gyro_saturation": Code(
            cause="Samples of the gyroscope are at the end of its measurement range.",
            cure=(
                "Choose a larger range or rotate more slowly; `--exclude-saturated` leaves out the affected "
                "rests and moves."
            ),
        ),
        "noise_below_lsb": Code(
            cause=(
                "The noise is smaller than a step of the converter, so averaging does not remove the "
                "rounding error. The standard deviations include this error."
            ),
            cure=(
                "Use a smaller measurement range or a wider filter bandwidth, or let the unit vibrate "
                "slightly at rest."
            ),
        ),
    },
    "Time stamps and lost samples": {
        "time_not_increasing": Code(
            cause=(
                "A time stamp is not later than the previous time stamp: rows are shuffled, two recordings "
                "are in one file, a counter overflowed, or lines lost characters, as on a serial line."
            ),
            cure=(
                "Remove damaged lines and rows that were written twice, cut the recording where it starts "
                "again, sort the rows, or use the time stamps of the sensor."
            ),
        ),
        "clock_rate": Code(
            cause="The sampling rate that follows from the time stamps is not plausible.",
            cure=(
                "Give the unit of the time in the column name (`time_ms`, `time_us`, `time_ns`), or "
                "`--rate-hz`."
            ),
        ),
        "clock_irregular": Code(
            cause=(
                "The time stamps are irregular. They are the times of packets or of the arrival of samples, "
                "and not the times of sampling."
            ),
            cure=(
                "Record the time stamps of the sensor. If no sample is missing, leave the times out and give "
                "`--rate-hz`."
            ),
        ),
        "samples_missing": Code(
            cause="Samples are lost: the time stamps have gaps, or the angular rate jumps.",
            cure=(
                "A few lost samples do no harm. If many are lost, look for lost packets or a full buffer, "
                "and record again."
            ),
        ),
        "samples_zero": Code(
            cause=(
                "All values of some rows are exactly zero. An accelerometer measures gravity, so these rows "
                "are not measurements; some loggers write zeros in place of lost samples."
            ),
            cure="Leave these rows out of the file. Gaps are detected and handled.",
        ),
        "samples_spiked": Code(
            cause=(
                "Single samples are far from both neighbours, while all other consecutive samples are close "
                "to each other: errors of the transmission or of the reader, or a blow to the unit."
            ),
            cure="Leave these rows out of the file, and look for the cause in the cable or the reader.",
        ),
        "samples_duplicated": Code(
            cause=(
                "Rows repeat the previous row, because a slower sensor was polled or rows were written "
                "twice; or rows of a table of means (`--means`) are copies."
            ),
            cure="Record at the rate at which the sensor has new samples, or drop the repeated rows.",
        ),
    },
    "Units": {
        "accel_units": Code(
            cause=(
                "The specific force at rest is not near gravity, so the values are not in the unit that the "
                "name of the column states."
            ),
            cure="Rename the columns (`accel_x_g`, `accel_x_mg`, `accel_x_lsb`), or give `--accel-unit`.",
        ),
        "gyro_units": Code(
            cause=(
                "The rates do not agree with the rotation of gravity, or are larger than any gyroscope "
                "measures."
            ),
            cure=(
                "Rename the columns (`gyro_x_dps`, `gyro_x_radps`, `gyro_x_lsb`), or give `--gyro-unit`; "
                "check the time column. If only one axis has large rates, only this column is in another "
                "unit: convert it to the unit of the other two."
            ),
        ),
        "counts_unsigned": Code(
            cause="Raw counts were read as unsigned numbers: they jump between the ends of the range.",
            cure="Subtract 65536 from values above 32767 (16 bits), or read the registers as signed numbers.",
        ),
        "gyro_common_gain": Code(
            cause=(
                "All gyroscope axes have the same scale factor error. The probable cause is the clock or the "
                "unit of the rates."
            ),
            cure=(
                "Compare the duration of the recording with another clock, and check the sensitivity used to "
                "convert counts."
            ),
        ),
        "gains_differ": Code(
            cause="The scale factor of one axis differs from the other two scale factors.",
            cure="Check how this column was scaled. For axes of different sensors, nothing has to be done.",
        ),
        "noise_implausible": Code(
            cause=(
                "Usual sensors do not have this noise density: the samples are in another unit, or the "
                "sensor is noisy because of vibration, its supply or its wiring."
            ),
            cure=(
                "Change the columns to the unit that the message names. If imucal then reports `gyro_units` "
                "or `accel_units`, the former unit was correct: change it back, and look for the source of "
                "the noise."
            ),
        ),
        "bias_implausible": Code(
            cause="No gyroscope has this bias, so the rates are probably in another unit.",
            cure="Rename the columns, for example to `gyro_x_dps`.",
        ),
        "temperature_implausible": Code(
            cause="The temperature is outside the range in which sensors work.",
            cure=(
                "Name the column by its unit (`temp_degc`, `temp_k`, `temp_degf`), or give `--temp-scale` "
                "for counts."
            ),
        ),
        "temperature_jump": Code(
            cause=(
                "The temperature jumps by more than 5 K between two samples, or has values that are not "
                "finite."
            ),
            cure="Repair the column or drop it. Effects of temperature need a value in every row.",
        ),
        "temperature_raw": Code(
            cause="The temperature is in raw counts without a scale and is not used.",
            cure="Give `--temp-scale SLOPE,OFFSET` from the datasheet.",
        ),
    },
    "Axes": {
        "gravity_sign": Code(
            cause=(
                "The accelerometer reads -g on z in the first rest: z points down (FRD, NED), the sign of "
                "the accelerometer is reversed, or the unit lay upside down."
            ),
            cure=(
                "If z points down, give `--axes frd`. If the sign is reversed, give `--axes accel=-x,-y,-z`. "
                "See [frames](frames.md)."
            ),
        ),
        "left_handed_axes": Code(
            cause=(
                "The rates do not follow the rotation of gravity: an axis is mirrored, or two axes are "
                "swapped."
            ),
            cure="Give the order and the signs of the columns with `--axes`; the message names them.",
        ),
        "sensors_not_together": Code(
            cause=(
                "The rates do not follow the rotation of gravity inside moves: the two sensors were recorded "
                "at different times, or belong to different units. The message is only a warning if the "
                "unit may also have been accelerated during the moves, as when it is carried."
            ),
            cure=(
                "Give the files of one unit and one recording. If one sensor is late, correct its time "
                "stamps. Without this correction, only the total rotation of each move is correct. If the "
                "unit was carried and the verdict is good, nothing has to be done."
            ),
        ),
        "axes_turned": Code(
            cause="The axes of the two sensors differ by a rotation in steps of 90 deg.",
            cure="Give `--axes` as in the message.",
        ),
    },
    "Several recordings": {
        "recordings_overlap": Code(
            cause=(
                "A recording is given twice, two recordings have samples in common, or `--calibration` was "
                "made from the same file."
            ),
            cure="Give every recording once; repeated data make the stated accuracy wrong.",
        ),
        "control_not_independent": Code(
            cause=(
                "The control recording contains the noise of a calibration recording, so it is a part or a "
                "copy of that recording; or `--calibration` was made from its file."
            ),
            cure=(
                "Record a separate control run, or omit `--control`: `gap` then verifies its result with "
                "held-out rests and moves, and `calibrate` does so with `--folds`."
            ),
        ),
        "temperature_extrapolated": Code(
            cause=(
                "The calibration is evaluated on a recording with temperatures that its recordings did not "
                "reach, so its temperature effects are extrapolated."
            ),
            cure=(
                "Evaluate on a recording within the temperatures of the calibration, or calibrate with "
                "recordings that cover the temperatures of this one."
            ),
        ),
        "seen_by_the_fit": Code(
            cause="The calibration is evaluated on a file from which it was made.",
            cure="Evaluate on another recording of the unit.",
        ),
        "several_units": Code(
            cause=(
                "The model fits each recording separately, but not all recordings together, so they are of "
                "different units."
            ),
            cure="Calibrate each unit separately.",
        ),
        "control_outliers": Code(
            cause=(
                "A few rests or moves of the control recordings contradict the others and do not count in "
                "the verdict."
            ),
            cure=(
                "Look at these rests and moves: the unit may have been touched, or its biases may have "
                "changed, as just after power-on."
            ),
        ),
        "recording_unused": Code(
            cause="The fit excludes all rests of a recording, because they contradict the other recordings.",
            cure="Check that the recording is of the same unit, or leave it out.",
        ),
        "biases_moved": Code(
            cause="The biases differ between the recordings, as after switching the unit off and on.",
            cure=(
                "Make all recordings without switching the unit off, or calibrate from one recording and "
                "estimate the bias again after each start."
            ),
        ),
    },
    "Reading files": {
        "lines_left_out": Code(
            cause="Lines of a text file are not rows of numbers and were left out.",
            cure="Check that these lines contained no samples.",
        ),
        "tables_not_read": Code(
            cause="A file with several tables contains further samples of the sensors, which were not read.",
            cure="To read them instead, write their tables to a separate file.",
        ),
        "read_by_header": Code(
            cause="Names and units of the columns were taken from the header of a file of another program.",
            cure=(
                "If names and units are right, nothing has to be done. Otherwise give `--columns`; for one "
                "file per sensor, give `--accel-unit` and `--gyro-unit`."
            ),
        ),
        "counts_assumed": Code(
            cause="Files without a header were read as raw counts, but the numbers are not integers.",
            cure="If the numbers have a unit, give it with `--accel-unit` and `--gyro-unit`.",
        ),
        "file_damaged": Code(
            cause="Parts of a log could not be read and were skipped.",
            cure="Look for gaps in time, or download the log again.",
        ),
        "checksums_missing": Code(
            cause=(
                "All sentences (lines such as $VNIMU,...) have a placeholder instead of a check sum, so "
                "damaged sentences are not found."
            ),
            cure="Record with check sums.",
        ),
        "resampled": Code(
            cause=(
                "The two sensors have different sampling rates; one was resampled to the time stamps of the "
                "other."
            ),
            cure=(
                "Nothing has to be done. If you need the noise of the sensors, record both at the same rate."
            ),
        ),
        "already_corrected": Code(
            cause="The autopilot has applied its own calibration to the logged samples.",
            cure=(
                "The new calibration applies in addition to the parameters of the autopilot. To replace "
                "these parameters, log raw samples, or set them to neutral values before you record."
            ),
        ),
        "board_rotated": Code(
            cause=(
                "The autopilot has rotated the samples from the axes of the sensor to the axes of the "
                "vehicle."
            ),
            cure="Export with `--board-orientation` as in the message.",
        ),
    },
    "Verdict poor": {
        "not_converged": Code(
            cause="A fit ended before it reached its optimum.",
            cure="Raise `--max-iterations`, or look for faulty parts of the recording with `--verbose`.",
        ),
        "no_usable_move": Code(
            cause="The recording has no usable move, so the gyroscope cannot be evaluated.",
            cure="Record rests in different poses with moves between them.",
        ),
        "too_few_rests": Code(
            cause="The recording has too few usable rests to evaluate the accelerometer.",
            cure="Record rests in more poses.",
        ),
        "not_corrected": Code(
            cause=(
                "Some samples cannot be corrected: their temperature is missing, or an effect is too large "
                "to be removed."
            ),
            cure="Repair the temperature column, or calibrate without this effect.",
        ),
        "large_residuals": Code(
            cause=(
                "The residuals are far larger than noise explains. The calibration is of another unit, the "
                "units of measurement are wrong, or the unit has a large error that the model does not "
                "contain."
            ),
            cure=(
                "Check that the file is of this unit and in the stated units of measurement; then run "
                "[`imucal gap run.csv --control control.csv`](gap.md)."
            ),
        ),
        "unknown_direction": Code(
            cause=(
                "Noise makes the direction of gravity after most moves too inaccurate, so the gyroscope "
                "cannot be evaluated."
            ),
            cure="Check the units, or move faster and rest longer.",
        ),
        "impossible_rates": Code(
            cause="The corrected rates are larger than any such sensor measures.",
            cure="Check the units of the rates and the calibration.",
        ),
        "worse_than_uncalibrated": Code(
            cause=(
                "The residuals are larger than without calibration, because the calibration is of another "
                "unit or for other units of measurement."
            ),
            cure="Check the serial number, and the units of measurement of the recording.",
        ),
        "contradicting_rests": Code(
            cause="Many rests contradict the other rests.",
            cure="Hold the unit still for at least two seconds in each pose, on something rigid.",
        ),
        "contradicting_moves": Code(
            cause=(
                "Many moves contradict the other moves, for example because of lost samples or saturation in "
                "moves."
            ),
            cure="Look at the findings, rotate more slowly, and record again.",
        ),
        "moving_rests": Code(
            cause=(
                "The mean angular rates at many rests differ strongly from those at the other rests, so the "
                "unit was rotating slowly at these rests."
            ),
            cure="Hold the unit still in each pose.",
        ),
        "prior_contradicted": Code(
            cause=(
                "The recordings contradict the prior of a parameter that is held, or the calibration that "
                "was given with `--calibration`."
            ),
            cure=(
                "Give a wider standard deviation to `--hold`, or estimate the parameter. Check that the "
                "given calibration is of this unit."
            ),
        ),
    },
    "Verdict incomplete": {
        "calibration_uncertain": Code(
            cause=(
                "The residuals on the control recordings are far larger than noise, as the uncertainty of "
                "the calibration predicts."
            ),
            cure="Calibrate with rests in more poses, and with moves about more axes.",
        ),
        "axes_not_tested": Code(
            cause=(
                "The control recordings do not test every axis: errors of 5 % would not be visible, alone or "
                "where they compensate each other."
            ),
            cure=(
                "Record rests in more poses, with each axis of the accelerometer up and down, and with "
                "rotations about every axis between them."
            ),
        ),
        "residuals_above_noise": Code(
            cause=(
                "Some residuals exceed twice their noise, because the model does not contain an error of the "
                "unit or a property of the motion."
            ),
            cure="The result is usable. [`imucal gap`](gap.md) searches for the missing effect.",
        ),
        "irregular_clock": Code(
            cause="Only the residuals of moves exceed their noise, and the time stamps are irregular.",
            cure="Use the time stamps of the sensor, or time stamps with equal steps.",
        ),
        "parameters_held": Code(
            cause=(
                "Parameters that the recording does not determine are held at nominal values. The message "
                "states how large the error of these values can be."
            ),
            cure="Record more poses, or accept the stated error. See [few poses](few-poses.md).",
        ),
        "residuals_not_tested": Code(
            cause=(
                "There are as many parameters as rests, or the noise is not known, so the residuals do not "
                "show whether the model fits."
            ),
            cure="Add poses, give `--noise`, or give a control recording.",
        ),
        "not_evaluated": Code(
            cause=(
                "The calibration was imported from another program and has not been evaluated on a recording."
            ),
            cure="Run `imucal evaluate CALIBRATION CONTROL`.",
        ),
    },
    "Diagnosis of a fit": {
        "traded_off": Code(
            cause="Parameters are so strongly correlated that they cannot be estimated separately.",
            cure="Record the motion that the message names, or hold one of the parameters with `--hold`.",
        ),
        "flat": Code(
            cause=("A parameter is poorly determined: its standard deviation exceeds its typical size."),
            cure="Record the motion that the message names, or hold the parameter with `--hold`.",
        ),
        "at_bound": Code(
            cause="An estimated time constant is outside the range that the recordings can determine.",
            cure="Record from power-on until the sensors have settled, or leave the effect out.",
        ),
        "noise_overestimated": Code(
            cause=(
                "The residuals are smaller than the estimated noise at the rests, so the standard deviations "
                "are too large."
            ),
            cure="Record a hand-held unit at 100 Hz or more, and a unit on a table without vibration.",
        ),
        "noise_grows_in_motion": Code(
            cause=(
                "The gyroscope is noisier in moves than at rest. `calibrate` computes the result; `gap` has "
                "the verdict `data_fault` if it names no effect."
            ),
            cure="Look for a source of vibration while the unit rotates.",
        ),
        "mount_slip": Code(
            cause="The unit has rotated on its mount during the run.",
            cure="Fasten the unit and record again.",
        ),
        "loose_mount": Code(
            cause=(
                "The attitude of the unit relative to the angles of the stand scatters, so the mount has "
                "play."
            ),
            cure="Fasten the unit and record again.",
        ),
    },
    "Noise of a unit at rest": {
        "recording_short": Code(
            cause="The recording is too short to show the bias instability; only its upper bound is known.",
            cure="Record for hours at a constant temperature if you need a value.",
        ),
        "recording_moves": Code(
            cause="The unit moves; only the longest rest is used.",
            cure="Record the unit at rest on something rigid.",
        ),
        "recording_interrupted": Code(
            cause="Samples are lost or repeated; only the longest part without such samples is used.",
            cure="Look for lost packets or a full buffer, and record again if the part is too short.",
        ),
        "step": Code(
            cause="The mean of some axes changes abruptly, for example because the table was bumped.",
            cure="`--cut-steps` uses the longest part without a step.",
        ),
        "steps_cut": Code(
            cause="Only the longest part without a step is used.",
            cure="Nothing has to be done. If the part is too short, record again without touching the table.",
        ),
        "drift": Code(
            cause="The mean drifts, as while a unit warms up. The estimated random walk includes this drift.",
            cure="Let the unit run for 30 minutes before recording.",
        ),
        "noise_filtered": Code(
            cause="A filter has attenuated the noise at high frequencies; only lower frequencies are used.",
            cure="Nothing has to be done. For a more accurate noise density, record without the filter.",
        ),
        "noise_model": Code(
            cause="The power spectrum differs from the noise model, for example because of vibration.",
            cure="Look at the Allan plot; record at a constant temperature, away from motors.",
        ),
    },
    "A run without a result": {
        "format": Code(
            cause="A file is damaged, incomplete or of another format.",
            cure="Check it with `imucal inspect`; give `--format`.",
        ),
        "input": Code(
            cause="An argument or a recording is invalid.",
            cure="Follow the message.",
        ),
        "file_missing": Code(
            cause="A file of the manifest does not exist.",
            cure="Correct the manifest, or copy the file.",
        ),
        "file_changed": Code(
            cause="A file was changed while it was being read.",
            cure="Run again when the file is complete.",
        ),
        "time_limit": Code(
            cause="The recording took longer than `--time-limit-s`, and its process was ended.",
            cure="Look at the recording with `imucal inspect`, or allow more time and give `--retry`.",
        ),
        "memory": Code(
            cause="The recording does not fit into memory.",
            cure="Give a shorter recording or fewer workers.",
        ),
        "no_result": Code(
            cause="An error without a code of its own.",
            cure="Follow the message.",
        ),
        "bug": Code(
            cause="An internal error of imucal.",
            cure="Report it with the traceback (`IMUCAL_TRACEBACK=1`).",
        ),
    },
}
# Kind of the codes in a group, by the heading of the group. The codes of all other groups are errors, except
# the codes in the two lists below.
KIND_OF_GROUP: Final = {
    "Reading files": "warning",
    "Verdict poor": "reason",
    "Verdict incomplete": "reason",
    "Diagnosis of a fit": "warning",
    "Noise of a unit at rest": "warning",
}
# Warnings in the groups that `KIND_OF_GROUP` does not list. A warning means that imucal computes a result in
# spite of the fault.
WARNINGS: Final = (
    "noise_below_lsb",
    "gyro_common_gain",
    "gains_differ",
    "noise_implausible",
    "bias_implausible",
    "recording_unused",
    "control_outliers",
    "temperature_jump",
    "temperature_raw",
    "axes_turned",
    "samples_spiked",
    "seen_by_the_fit",
    "temperature_extrapolated",
    "biases_moved",
)
# Codes that are errors only if the fault is large or of a certain kind, and warnings otherwise.
ERRORS_OR_WARNINGS: Final = (
    "sensors_not_together",
    "sensor_missing",
    "non_finite",
    "stuck_axis",
    "accel_saturation",
    "gyro_saturation",
    "clock_irregular",
    "samples_missing",
    "samples_duplicated",
    "gravity_sign",
)
HEAD: Final = """# Why refused? All reason codes

Copy the code in brackets from the message or from the line of the verdict, such as `[gyro_units]`, and find
it on this page, or run `imucal help gyro_units`. Some messages show no code. They contain the remedy, most
often poses to add; the code of such a message in JSON documents is `not_enough_motion`. In a verdict, "above
its limit" refers to a limit in the file that was given with `--limits`.

The column **kind** gives the consequence of a code:

* **error**: the recording is refused, because the result would be wrong. `imucal apply` prints errors of
  units and time stamps as warnings.
* **warning**: the result is computed; its message begins with "warning".
* **error or warning**: the message begins with "warning" if a result can be computed in spite of the fault.
* **reason**: the code explains the verdict of the result.

JSON documents have the code in the field `code`. The codes do not change between versions, so that scripts
can rely on them. The codes of a production line, such as `dead_axis`, are on the page of [the
stand](stand.md#one-unit-one-command).
"""


def kind_of(code: str, heading: str) -> str:
    """The kind of a code in the group with this heading: error, warning, reason, or error or warning."""
    if code in ERRORS_OR_WARNINGS:
        return "error or warning"
    return "warning" if code in WARNINGS else KIND_OF_GROUP.get(heading, "error")


def code_text(code: str) -> str | None:
    """Cause and cure of a code as text for a terminal; None if there is no such code."""
    for heading, entries in CODES.items():
        if code in entries:
            entry = entries[code]
            return (
                f"{code} ({heading}): {kind_of(code, heading)}\n  cause: {_plain(entry.cause)}\n"
                f"  what to do: {_plain(entry.cure)}"
            )
    return None


def _plain(text: str) -> str:
    """Remove the Markdown markup from a text."""
    return re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", text).replace("`", "")


def codes_markdown() -> str:
    """The text of the page docs/codes.md."""
    lines = [HEAD]
    for heading, entries in CODES.items():
        lines += [f"## {heading}", "", "| code | kind | cause | what to do |", "|---|---|---|---|"]
        lines += [
            f"| `{code}` | {kind_of(code, heading)} | {entry.cause} | {entry.cure} |"
            for code, entry in entries.items()
        ]
        lines.append("")
    return "\n".join(lines)
