"""Bad recordings: each row of the tables in `bad_recordings`, by command and by call.

A message says what, where, the number, and the way out.
"""

import dataclasses
import json
import re
import sys
from pathlib import Path

import numpy as np
import pytest

import imucal
from bad_recordings import ELSEWHERE, POOR, REFUSED, WARNED, axis, counts, outer_join
from changes import (
    changed,
    force,
    noise,
    rate,
    stand_run,
    time,
)
from imucal import InputError
from imucal.cli import main

COMMAND = Path(sys.executable).with_name("imucal")
CHECKS = Path(__file__).resolve().parents[2] / "rust" / "imucal" / "src" / "check"


def text_of(error):
    """The message, which has a way out and nothing of the machine."""
    message = str(error)
    assert ": " in message or "give" in message, message
    assert "Some(" not in message and "Traceback" not in message, message
    return message


def command_line(options):
    names = {"gravity_mps2": "gravity"}
    line = []
    for name, value in options.items():
        flag = "--" + names.get(name, name).replace("_", "-")
        line += [flag] if value is True else [f"{flag}={value}"]
    return line


def written(recordings, folder):
    recordings = recordings if isinstance(recordings, list) else [recordings]
    paths = [folder / f"{number}.parquet" for number in range(len(recordings))]
    for recording, path in zip(recordings, paths, strict=True):
        imucal.write(recording, path)
    return [str(path) for path in paths]


@pytest.mark.parametrize("name", REFUSED)
def test_refused(name, tmp_path, capsys):
    case = REFUSED[name]
    recordings = case.change(stand_run().recording)
    with pytest.raises(case.error, match=re.compile(case.words, re.DOTALL)) as caught:
        imucal.calibrate(recordings, **case.options)
    assert type(caught.value) is case.error
    if case.words != "give at least one|Missing argument":
        text_of(caught.value)
    findings = getattr(caught.value, "findings", [])
    if case.code is not None:
        assert any(re.fullmatch(case.code, finding.code) for finding in findings), findings
    for finding in findings:
        assert finding.severity == "error"
        assert len(finding.way_out) > 10
        assert finding.code == "empty" or re.search(r"\d", finding.message)
        assert f"[{finding.code}]" in str(caught.value)

    output = tmp_path / "cal.json"
    before = [*written(recordings, tmp_path)]
    assert main(["calibrate", *before, "-o", str(output), *command_line(case.options)]) == 1
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.startswith("imucal: ")
    assert "Traceback" not in shown.err
    assert re.search(case.words, shown.err, re.DOTALL)
    assert all(f"[{finding.code}]" in shown.err for finding in findings)
    assert sorted(map(str, tmp_path.iterdir())) == before


def test_an_outer_join_in_memory_is_refused_with_the_way_out():
    # A file with such rows is resampled (tests/io/test_separate_rows.py).
    with pytest.raises(
        InputError, match=r"in separate rows: 6100 .* different time stamps: first interp"
    ) as caught:
        imucal.calibrate(outer_join(stand_run().recording))
    assert [finding.code for finding in caught.value.findings] == ["non_finite"]


@pytest.mark.parametrize("name", [name for name, case in REFUSED.items() if case.code and not case.options])
def test_inspect_shows_what_is_refused(name, tmp_path, capsys):
    recordings = REFUSED[name].change(stand_run().recording)
    paths = written(recordings, tmp_path)
    code = main(["inspect", *paths, "--json", str(tmp_path / "seen.json")])
    seen = json.loads((tmp_path / "seen.json").read_text())["recordings"]
    assert code in (0, 2)
    assert (code == 0) == all(item["usable"] and item["missing"] is None for item in seen)
    # What the columns and rests show is a finding; what only the fit shows is said to be missing.
    shown = capsys.readouterr().out
    assert REFUSED[name].code == "recordings_overlap" or re.search(rf"\[({REFUSED[name].code})\]", shown)


def test_apply_refuses_counts_that_lost_their_sign(tmp_path, capsys):
    recording = stand_run().recording
    unit = imucal.calibrate(counts(recording)).calibration
    assert np.isfinite(unit.apply_recording(counts(recording)).angular_rate).all()
    said = "counts_unsigned.* subtract 65536 from values above 32767"
    with pytest.raises(InputError, match=re.compile(said, re.DOTALL)):
        unit.apply_recording(counts(recording, wrap=65536))
    unit.save(tmp_path / "cal.json")
    [run] = written(counts(recording, wrap=65536), tmp_path)
    assert main(["apply", str(tmp_path / "cal.json"), run, "-o", str(tmp_path / "out.csv")]) == 1
    assert re.search(said, capsys.readouterr().err, re.DOTALL)
    assert not (tmp_path / "out.csv").exists()


@pytest.mark.parametrize(
    ("serial_number", "said"),
    [(42, "give text, '42'"), ("", "is empty"), (" ", "is empty"), ("a\nb", "can be printed")],
)
def test_what_is_no_serial_number_is_refused(serial_number, said, tmp_path, capsys):
    recording = stand_run().recording
    with pytest.raises(InputError, match=said):
        imucal.calibrate(recording, serial_number=serial_number)
    with pytest.raises(InputError, match=said):
        dataclasses.replace(stand_run().truth.calibration, serial_number=serial_number)
    if isinstance(serial_number, str):
        [run] = written(recording, tmp_path)
        assert main(["calibrate", run, "--serial-number", serial_number]) == 1
        assert said in capsys.readouterr().err


def test_a_control_recording_counts_once(tmp_path, capsys):
    run, control = stand_run().recording, stand_run(seed=2).recording
    said = "the control recordings .* have the same .* samples: give every recording once"
    with pytest.raises(InputError, match=said):
        imucal.calibrate(run, control=[control, control])
    unit = imucal.calibrate(run).calibration
    with pytest.raises(InputError, match=said):
        imucal.evaluate(unit, [control, changed(control, name="copy")])


@pytest.mark.parametrize("share", [0.3, 0.45])
def test_a_bias_that_jumps_is_no_good_verdict(share):
    recording = stand_run().recording
    jump = np.zeros((len(recording), 3))
    jump[int((1 - share) * len(recording)) :, 0] = 0.02
    result = imucal.calibrate(changed(recording, angular_rate=recording.angular_rate + jump))
    assert result.verdict == "poor"
    assert "rests are left out because their mean rates are far from those of the others" in result.reasons[0]


@pytest.mark.parametrize("rows", [50, None])
def test_old_line_ends_are_read(rows, tmp_path):
    imucal.write(stand_run().recording, tmp_path / "run.csv")
    lines = (tmp_path / "run.csv").read_bytes().splitlines()[:rows]
    (tmp_path / "old.csv").write_bytes(b"\r".join([*lines, b""]))
    (tmp_path / "new.csv").write_bytes(b"\n".join([*lines, b""]))
    old, new = (imucal.read(tmp_path / name) for name in ("old.csv", "new.csv"))
    np.testing.assert_array_equal(old.angular_rate, new.angular_rate)
    whole = list(imucal.io.read_pieces(tmp_path / "old.csv"))
    assert sum(map(len, whole)) == len(new)


@pytest.mark.parametrize("name", POOR)
def test_poor(name, tmp_path, capsys):
    recordings = POOR[name](stand_run().recording)
    result = imucal.calibrate(recordings)
    assert result.verdict == "poor"
    assert "times what noise explains" in result.reasons[0] or "contradict the others" in result.reasons[0]
    paths = written(recordings, tmp_path)
    assert main(["calibrate", *paths, "-o", str(tmp_path / "cal.json")]) == 2
    assert f"verdict: poor; {result.reasons[0]}" in capsys.readouterr().out


def errors_in_sigmas(result, truth):
    values = {parameter.name: parameter.value for parameter in truth.parameters}
    return {p.name: (p.value - values[p.name]) / p.std for p in result.parameters}


@pytest.mark.parametrize("name", WARNED)
def test_warned_and_right(name, tmp_path, capsys):
    change, code = WARNED[name]
    recording = change(stand_run().recording)
    result = imucal.calibrate(recording)
    assert result.verdict == "good"
    assert [finding.code for finding in result.findings if finding.severity == "warning"].count(code) == 1
    errors = errors_in_sigmas(result, stand_run().truth.calibration)
    assert max(map(abs, errors.values())) < 5, errors
    assert main(["calibrate", *written(recording, tmp_path), "-o", str(tmp_path / "cal.json")]) == 0
    assert f"[{code}]" in capsys.readouterr().out
    assert (tmp_path / "cal.json").exists()


def test_moves_that_the_jitter_of_the_clock_spoils_are_no_good_verdict(tmp_path, capsys):
    recording = time(lambda t: np.sort(noise(0.0025)(t)))(stand_run().recording)
    result = imucal.calibrate(recording)
    assert result.verdict == "incomplete"
    assert "gravity direction after the moves" in result.reasons[0]
    assert "clock_irregular" in [finding.code for finding in result.findings]
    main(["calibrate", *written(recording, tmp_path), "-o", str(tmp_path / "cal.json")])
    shown = capsys.readouterr().out
    assert "verdict: incomplete" in shown
    assert "[clock_irregular]" in shown


def test_turned_gyroscope_is_calibrated_as_it_is_mounted():
    turn = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])
    run = stand_run()
    result = imucal.calibrate(rate(lambda w: w @ turn.T)(run.recording))
    assert [finding.code for finding in result.findings] == ["axes_turned"]
    assert result.verdict == "good"
    expected = turn @ run.truth.calibration.gyroscope.sensitivity
    np.testing.assert_allclose(result.calibration.gyroscope.sensitivity, expected, atol=2e-3)


def test_reversed_gravity_without_a_stand_is_said():
    result = imucal.calibrate(force(lambda f: -f)(stand_run().recording))
    assert [(f.code, f.severity) for f in result.findings] == [("gravity_sign", "warning")]


def test_an_axis_in_other_counts_than_the_others_is_said():
    in_counts = counts(stand_run().recording)
    assert not imucal.calibrate(in_counts).findings
    result = imucal.calibrate(rate(axis(1, 0.5))(in_counts))
    assert [(f.code, f.severity, f.columns) for f in result.findings] == [
        ("gains_differ", "warning", ("gyro_y",))
    ]


def test_every_code_has_a_case():
    """A code in the checks that no table expects fails here."""
    source = "".join(
        path.read_text().split("#[cfg(test)]\nmod tests")[0]
        for path in [*CHECKS.glob("*.rs"), CHECKS.with_suffix(".rs")]
    )
    used = set(re.findall(r'\(\s*"([a-z_]+)",\s*(?:recording|ACCEL|GYRO)\b', source))
    used |= set(re.findall(r'[( ]"([a-z]+_units)"', source))
    documented = {
        code
        for text in re.findall(r"Codes?: (.*?)\.\n", source, re.DOTALL)
        for code in re.findall(r"`([a-z_]+)`", text)
    }
    assert documented <= used
    assert len(used) >= 19
    expected = {code for case in REFUSED.values() for code in (case.code or "").split("|")}
    expected |= {code for _, code in WARNED.values()} | ELSEWHERE
    assert used <= expected
    assert expected - {""} <= used
