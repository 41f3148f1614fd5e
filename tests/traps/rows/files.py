"""Traps of text files: what loggers, apps and serial lines write around and between the numbers."""

import datetime
import gzip
import zipfile
from pathlib import Path

import numpy as np

import imucal
from changes import stand_run, truth_of
from trap import Options, Question, Trap, good, refused

HEADER = "time_s,accel_x_mps2,accel_y_mps2,accel_z_mps2,gyro_x_radps,gyro_y_radps,gyro_z_radps"
G, DEG = 9.80665, np.pi / 180
START = datetime.datetime(2026, 1, 31, 23, 59, 0)
KINDS = {
    "layout": "a text file in another layout",
    "units": "units in the header of a text file",
    "contradiction": "a header that contradicts the options",
    "left out": "lines of a text file that are no rows",
    "refused": "a text file that is no recording",
    "dates": "dates as time stamps",
    "two files": "accelerometer and gyroscope in separate files",
}


def numbers(time_scale=1.0, accel=1.0, gyro=1.0):
    """Time, force and rate of the run as columns, in other units."""
    run = stand_run().recording
    return np.column_stack([run.time_s / time_scale, run.specific_force / accel, run.angular_rate / gyro])


def lines(values, separator=",", form="{:.9g}"):
    row_form = separator.join([form] * values.shape[1])
    return [row_form.format(*row) for row in values.tolist()]


def texts(header=HEADER, values=None):
    return [header, *lines(numbers() if values is None else values)]


def reading(kind, name, write, *right, **options):
    """A trap that calibrates what `write` puts into a folder; it returns one path or several."""

    def make(folder):
        written = write(folder)
        paths = list(written) if isinstance(written, (list, tuple)) else [written]
        words = ["calibrate", *map(str, paths), *Options(options).words()]

        def call():
            return imucal.calibrate(imucal.read(*paths, **options))

        return Question(words, call, truth_of(stand_run()))

    return Trap(KINDS[kind], name, make, right)


def text(kind, name, rows, *right, encode=lambda text: text.encode(), file="run.csv", end="\n", **options):
    """A trap of one text file; `rows` returns its lines."""

    def write(folder):
        (folder / file).write_bytes(encode(end.join(rows()) + end))
        return folder / file

    return reading(kind, name, write, *right, **options)


def named(time, accel, gyro):
    """A header with the axes in the places of `{}`."""
    return ",".join([time, *(accel.format(a) for a in "xyz"), *(gyro.format(a) for a in "xyz")])


LAYOUTS = (
    text(
        "layout", "decimal commas", lambda: [r.replace(",", ";").replace(".", ",") for r in texts()], good()
    ),
    text("layout", "tabs", lambda: [row.replace(",", "\t") for row in texts()], good()),
    text("layout", "UTF-16", texts, good(), encode=lambda text: text.encode("utf-16")),
    text("layout", "gzip", texts, good(), encode=lambda t: gzip.compress(t.encode(), 1), file="run.csv.gz"),
    text("layout", "carriage returns", texts, good(), end="\r"),
    text("layout", "quotes", lambda: ['"' + row.replace(",", '","') + '"' for row in texts()], good()),
    text("layout", "40 comments", lambda: [*(f"# note {i}: {i}" for i in range(40)), *texts()], good()),
    text("layout", "sep=;", lambda: ["sep=;", *(row.replace(",", ";") for row in texts())], good()),
    text("layout", "a header in a comment", lambda: texts("# " + HEADER), good()),
    text(
        "layout",
        "text in a left-out column",
        lambda: ["unit 1," + row for row in lines(numbers())],
        good(),
        columns="-," + HEADER,
    ),
    text(
        "layout",
        "labels and units",
        lambda: lines_of_labels(),
        good("read_by_header"),
        file="plotter.txt",
    ),
    text("layout", "VectorNav sentences", lambda: sentences(), good(), rate_hz=100),
    text("layout", "VectorNav sentences, 5 wrong", lambda: sentences(5), good("5 sentences"), rate_hz=100),
)


def lines_of_labels():
    return [
        "t: {:.4f} s, ax: {:.7f} m/s2, ay: {:.7f} m/s2, az: {:.7f} m/s2, "
        "gx: {:.8f} rad/s, gy: {:.8f} rad/s, gz: {:.8f} rad/s".format(*row)
        for row in numbers()
    ]


def sentences(wrong=0):
    made = []
    for row in lines(numbers()[:, 1:], form="{:+.7f}"):
        body = "VNYMR,+1.0,+2.0,+3.0,+0.1,+0.2,+0.3," + row
        total = 0
        for byte in body.encode():
            total ^= byte
        made.append(f"${body}*{total:02X}")
    # The last sentences, which are at rest: a lost line shifts the time of what follows.
    for index in range(len(made) - wrong, len(made)):
        made[index] = made[index].replace("+", "-", 1)
    return made


UNITS = (
    *tuple(
        text(
            "units",
            f"{accel} and {gyro}",
            lambda a=accel, g=gyro, s=scales: texts(named("Time (s)", a, g), numbers(1, *s)),
            good("read_by_header"),
        )
        for accel, gyro, scales in (
            ("Acc {} (g)", "Gyr {} (deg/s)", (G, DEG)),
            ("A_{} [mg]", "G_{} [dps]", (G / 1000, DEG)),
            ("Acceleration {}(g)", "Angular velocity {}(°/s)", (G, DEG)),
            ("accel{} (m.s^-2)", "gyro{} (rad.s^-1)", (1, 1)),
            ("{}Accel (m/s/s)", "{}Rate (mdps)", (1, DEG / 1000)),
            ("Acc {} (cm/s²)", "Gyr {} (mrad/s)", (0.01, 1e-3)),
            ("Acc {} [Gal]", "Gyr {} [°/h]", (0.01, DEG / 3600)),
            ("acc_{}_mm_s2", "Gyr {} (rpm)", (1e-3, 6 * DEG)),
        )
    ),
    text(
        "units",
        "a line of units",
        lambda: [
            named("Timestamp", "Acc_{}", "Gyro_{}"),
            "ms,m/(s^2),m/(s^2),m/(s^2),deg/s,deg/s,deg/s",
            *lines(numbers(0.001, 1, DEG)),
        ],
        good("read_by_header"),
    ),
    text(
        "units",
        "Movella DOT",
        lambda: [
            "sep=,",
            "DeviceTag:,1",
            "OutputRate:,60Hz",
            named("SampleTimeFine", "Acc_{}", "Gyr_{}"),
            *lines(numbers(1e-06, 1, DEG)),
        ],
        good("Movella DOT"),
    ),
    text(
        "units",
        "Xsens MT Manager",
        lambda: (
            ["// General information:", "//  MT Manager version: 2022"]
            + [named("SampleTimeFine", "Acc_{}", "Gyr_{}").replace(",", "\t")]
            + [row.replace(",", "\t") for row in lines(numbers(0.0001))]
        ),
        good("Xsens MT Manager"),
    ),
    *tuple(
        text(
            "units",
            f"{accel} and {gyro}, which are not read",
            lambda a=accel, g=gyro, s=scales: texts(named("Time (s)", a, g), numbers(1, *s)),
            refused(r"units that are not read(?!.*_x_\w+=)"),
        )
        for accel, gyro, scales in (
            ("Acc {} (inch/s²)", "Gyr {} (rad/s)", (0.0254, 1)),
            ("Acc {} (0.01 m/s²)", "Gyr {} (rad/s)", (0.01, 1)),
            ("Acc {} km/s²", "Gyr {} (rad/s)", (1000, 1)),
            ("Acc {} (g)", "Gyr {} (grad/s)", (G, 0.9 * DEG)),
            ("Acc {} (g)", "gyro_{}_rps", (G, 360 * DEG)),
            ("Acc {} (g)", "Gyr {} (DPS x10)", (G, DEG / 10)),
        )
    ),
    *tuple(
        text(
            "units",
            f"{time}, which is not read",
            lambda t=time, s=scale: texts(named(t, "Acc {} (m/s^2)", "Gyr {} (rad/s)"), numbers(s)),
            refused(r"unit of time that is not read(?!.*time_m?s=)"),
        )
        for time, scale in (("t (ticks)", 1 / 1024), ("time_frames", 0.01), ("t (10 msec)", 0.01))
    ),
    text("units", "none, SI", lambda: texts("t,ax,ay,az,gx,gy,gz"), refused("gyro_x_radps=gx")),
    text(
        "units",
        "none, deg/s",
        lambda: texts("t,ax,ay,az,gx,gy,gz", numbers(1, 1, DEG)),
        refused("gyro_x_dps=gx|the data do not tell"),
    ),
    text("units", "none, g", lambda: texts("t,ax,ay,az,gx,gy,gz", numbers(1, G)), refused("accel_x_g=ax")),
)

CONTRADICTIONS = (
    text(
        "contradiction",
        "axes z, y, x",
        lambda: texts("t,az,ay,ax,gz,gy,gx"),
        refused("axis z"),
        columns=HEADER,
    ),
    text(
        "contradiction",
        "gyroscope first",
        lambda: texts("t,gx,gy,gz,ax,ay,az"),
        refused("a gyroscope"),
        columns=HEADER,
    ),
    text(
        "contradiction",
        "g for m/s^2",
        lambda: texts(named("t", "a{} [g]", "g{} [rad/s]"), numbers(1, G)),
        refused("contradicts"),
        columns=HEADER,
    ),
    text(
        "contradiction",
        "deg/s for rad/s",
        lambda: texts(named("t", "a{} [m/s^2]", "g{} [deg/s]"), numbers(1, 1, DEG)),
        refused("contradicts"),
        columns="time_s=t,"
        + ",".join(f"accel_{a}_mps2=a{a} [m/s^2],gyro_{a}_radps=g{a} [deg/s]" for a in "xyz"),
    ),
    text(
        "contradiction",
        "mg for cm/s^2",
        lambda: texts(named("t", "a{} (cm/s²)", "g{} (rad/s)"), numbers(1, 0.01)),
        refused("contradicts"),
        columns="time_s=t,"
        + ",".join(f"accel_{a}_mg=a{a} (cm/s²),gyro_{a}_radps=g{a} (rad/s)" for a in "xyz"),
    ),
    text(
        "contradiction",
        "g for numbers in m/s^2",
        lambda: texts(named("Time (s)", "Acc {} (g)", "Gyr {} (rad/s)")),
        refused("the header says g"),
    ),
)


def among(at, *added, every=None):
    """The lines of the run with lines added after row `at`, or after every n-th row."""
    made = texts()
    if every is None:
        return made[:at] + list(added) + made[at:]
    return [
        line for i, row in enumerate(made) for line in ((row, *added) if i and i % every == 0 else (row,))
    ]


def garbled(count):
    made = texts()
    # Of rests: a sample lost in a move would be found by another check.
    for index in range(2, 2 + count):
        made[index] = made[index].replace(".", "@", 2)
    return made


LEFT_OUT = (
    text("left out", "messages", lambda: among(0, "FIFO overflow!", every=500), good("24 lines of text")),
    text("left out", "a second header", lambda: among(700, HEADER), good("1 lines of text")),
    text("left out", "rows of separators", lambda: among(700, ",,,,,,", ",,,,,,"), good("2 rows without")),
    text("left out", "notes at the end", lambda: [*texts(), "", "Samples: 12200", "# stopped"], good("text")),
    reading("left out", "half a last line", lambda folder: cut(folder / "run.csv"), good("incomplete last")),
    text("left out", "3 garbled lines", lambda: garbled(3), good("3 lines with text")),
    text("left out", "copies of rows", lambda: twice(60), good("samples_duplicated")),
    text("left out", "a block written twice", lambda: block_twice(), good("100 rows are exact copies")),
)


def cut(path):
    path.write_text("\n".join([*texts(), "122.0,0.01,9"]))
    return path


def twice(every):
    return [line for i, row in enumerate(texts()) for line in ([row] * (2 if i and i % every == 0 else 1))]


def block_twice():
    made = texts()
    return made[:600] + made[500:600] + made[600:]


def same_stamps_with_other_values():
    made = texts()
    return [
        made[i - 1].split(",")[0] + "," + row.split(",", 1)[1] if i % 50 == 2 else row
        for i, row in enumerate(made)
    ]


REFUSED = (
    text(
        "refused", "mostly text", lambda: among(0, "state: ok", "battery: full", every=1), refused("of text")
    ),
    text("refused", "a tenth of the lines garbled", lambda: garbled(1220), refused("is not a number")),
    text(
        "refused",
        "acceleration without gravity",
        lambda: texts(
            named("Time (s)", "Linear Acceleration {} (m/s^2)", "Gyroscope {} (rad/s)"),
        ),
        refused("without gravity"),
    ),
    text(
        "refused",
        "acceleration without gravity, by its size",
        lambda: texts(
            named("Time (s)", "Acceleration {} (m/s^2)", "Gyroscope {} (rad/s)"), numbers(1, 1000.0)
        ),
        refused("not to include gravity"),
    ),
    text("refused", "equal stamps, other values", same_stamps_with_other_values, refused("time")),
    text(
        "refused",
        "an old spreadsheet",
        lambda: ["x" * 600],
        refused("spreadsheet"),
        encode=lambda text: b"\xd0\xcf\x11\xe0\xa1\xb1\x1a\xe1" + text.encode(),
        file="run.xls",
    ),
    reading(
        "refused", "a spreadsheet", lambda folder: spreadsheet(folder / "run.xlsx"), refused("save the sheet")
    ),
)


def spreadsheet(path: Path):
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("[Content_Types].xml", "<Types/>")
        archive.writestr("xl/workbook.xml", "<workbook/>")
    return path


DATES = tuple(
    text(
        "dates",
        name,
        lambda form=form: [
            HEADER,
            *(
                form(START + datetime.timedelta(microseconds=round(float(row[0]) * 1e6))) + "," + numbers_of
                for row, numbers_of in zip(numbers(), lines(numbers()[:, 1:]), strict=True)
            ),
        ],
        good(),
    )
    for name, form in (
        ("ISO 8601", lambda at: at.isoformat(timespec="milliseconds") + "Z"),
        ("a colon before the ms", lambda at: at.strftime("%Y-%m-%d %H:%M:%S:%f")[:-3]),
        ("a month by name", lambda at: at.strftime("%d-%b-%Y %H:%M:%S.%f")),
        ("time of day over midnight", lambda at: at.strftime("%H:%M:%S.%f")),
        ("day and month in numbers", lambda at: at.strftime("%d/%m/%Y %H:%M:%S.%f")),
        ("AM and PM", lambda at: at.strftime("%m/%d/%Y %I:%M:%S.%f %p")),
    )
)


def pair(
    folder,
    accel="x,y,z",
    gyro="x,y,z",
    *,
    names=("Accelerometer", "Gyroscope"),
    late=0,
    time="Time (s)",
    force=1.0,
):
    values = numbers()
    paths = []
    for name, header, part in (
        (names[0], accel, values[:, 1:4] * force),
        (names[1], gyro, values[late:, 4:]),
    ):
        stamps = values[-len(part) :, :1]
        order = ["xyz".index(axis[0].lower()) for axis in header.split(",")]
        path = folder / f"{name}.csv"
        path.write_text("\n".join([f"{time},{header}", *lines(np.hstack([stamps, part[:, order]]))]) + "\n")
        paths.append(path)
    return paths


SI = {"accel": "X (m/s^2),Y (m/s^2),Z (m/s^2)", "gyro": "X (rad/s),Y (rad/s),Z (rad/s)"}
LOGGER = {"accel": "z,y,x", "gyro": "z,y,x", "time": "seconds_elapsed"}
TOTAL = ("TotalAcceleration", "Gyroscope")


def packed(folder, **options):
    pair(folder, **options)
    with zipfile.ZipFile(folder / "phone.zip", "w") as archive:
        for path in folder.glob("*.csv"):
            archive.write(path, path.name)
    return folder / "phone.zip"


def in_folder(folder):
    inside = folder / "phone"
    inside.mkdir()
    pair(inside, **SI)
    return inside


TWO_FILES = (
    reading("two files", "equal stamps", lambda folder: pair(folder, **SI), good("read_by_header")),
    reading("two files", "in the other order", lambda folder: pair(folder, **SI)[::-1], good()),
    reading("two files", "other stamps", lambda folder: pair(folder, late=3, **SI), good("resampled")),
    reading("two files", "axes z, y, x", lambda folder: pair(folder, names=TOTAL, **LOGGER), good()),
    reading("two files", "zip", lambda folder: packed(folder, names=TOTAL, **LOGGER), good()),
    reading("two files", "folder", in_folder, good()),
    reading(
        "two files",
        "acceleration without gravity",
        lambda folder: pair(folder, force=1e-3, **LOGGER),
        refused("writes acceleration with gravity as TotalAcceleration"),
        format="pair",
    ),
    reading(
        "two files",
        "no unit",
        lambda folder: pair(folder),
        refused("--gyro-unit"),
        format="pair",
    ),
    reading(
        "two files",
        "a unit that the header contradicts",
        lambda folder: pair(folder, **SI),
        refused("contradicts"),
        format="pair",
        gyro_unit="deg/s",
    ),
)

TRAPS = (*LAYOUTS, *UNITS, *CONTRADICTIONS, *LEFT_OUT, *REFUSED, *DATES, *TWO_FILES)
