"""Members of JSON objects that are texts, or state a unit."""

import json

import numpy as np
import pytest

import imucal
from export_files import DEG, FORCE, NS, RATE, ROWS, TIME_S, G, write

TEXTS = {f"text {at}": "value" for at in range(9)}


def xyz(values):
    return dict(zip("xyz", values, strict=True))


def read(tmp_path, document, **options):
    return imucal.read(write(tmp_path, "run.json", json.dumps(document)), **options)


def check(recording):
    assert len(recording) == ROWS
    np.testing.assert_allclose(recording.specific_force, FORCE, atol=1e-12)
    np.testing.assert_allclose(recording.angular_rate, RATE, atol=1e-12)


def samples(accel, gyro, force=FORCE / G, rate=RATE / DEG):
    """Rows made by the functions `accel` and `gyro` from the samples in g and deg/s."""
    rows = zip(TIME_S.tolist(), force.tolist(), rate.tolist(), strict=True)
    return [{"time_s": t} | accel(f) | gyro(w) for t, f, w in rows]


FORMS = {
    "name of the outer member": samples(lambda f: {"acc_g": xyz(f)}, lambda w: {"gyro_dps": w}),
    "canonical names of vectors": samples(
        lambda f: {"accel_mps2": f}, lambda w: {"gyro_radps": w}, FORCE, RATE
    ),
    "columns": {
        "time_s": TIME_S.tolist(), "acc_g": (FORCE / G).tolist(), "gyro_dps": (RATE / DEG).tolist()
    },
    "member beside the axes": samples(
        lambda f: {"acc": xyz(f) | {"unit": "g"}}, lambda w: {"gyr": xyz(w) | {"unit": "deg/s"}}
    ),
    "member for each sensor": samples(
        lambda f: {"ax": f[0], "ay": f[1], "az": f[2], "accUnit": "g"},
        lambda w: {"gx": w[0], "gy": w[1], "gz": w[2], "gyro_unit": "dps"},
    ),
}  # fmt: skip


@pytest.mark.parametrize("form", FORMS)
def test_units_are_read_and_not_contradicted(tmp_path, form):
    check(read(tmp_path, FORMS[form]))
    if form == "name of the outer member":
        wrong = "time_s=time_s," + ",".join(
            f"accel_{a}_g=acc_g.{a},gyro_{a}_radps=gyro_dps.{a}" for a in "xyz"
        )
        with pytest.raises(imucal.InputError, match="contradicts the given columns: gyro_x_radps"):
            read(tmp_path, FORMS[form], columns=wrong)
        check(read(tmp_path, FORMS[form], columns=wrong.replace("radps=", "dps=")))


@pytest.mark.parametrize("place", ["sample", "list", "columns"])
def test_units_of_a_list(tmp_path, place):
    def table(values, unit):
        rows = [{"t": ns, **xyz(own)} for ns, own in zip(NS.tolist(), values.tolist(), strict=True)]
        if place == "sample":
            return [row | {"unit": unit} for row in rows]
        if place == "list":
            return {"unit": unit, "samples": rows}
        return {"unit": unit} | {name: [row[name] for row in rows] for name in rows[0]}

    document = {"acc": table(FORCE, "m/s^2"), "gyro": table(RATE / DEG, "deg/s")}
    check(read(tmp_path, document))
    with pytest.raises(imucal.InputError, match="header contradicts the given unit: it says dps"):
        read(tmp_path, document, gyro_unit="rad/s")


def test_units_that_disagree_are_refused(tmp_path):
    rows = FORMS["member beside the axes"]
    other = {"acc": rows[7]["acc"] | {"unit": "mg"}}
    with pytest.raises(imucal.FormatError, match=r"'acc.unit' states several units \(g, mg\)"):
        read(tmp_path, [*rows[:7], rows[7] | other, *rows[8:]])
    renamed = [{"acc (m/s^2)" if name == "acc" else name: own for name, own in row.items()} for row in rows]
    with pytest.raises(imucal.FormatError, match=r"unit m/s\^2, and the member .*unit' states g"):
        read(tmp_path, renamed)
    unknown = samples(lambda f: {"acc_g": f}, lambda w: {"gyro_rps": w})
    with pytest.raises(imucal.FormatError, match=r"units that are not read \(rps\)"):
        read(tmp_path, unknown)


def test_units_outside_the_table_are_reported(tmp_path):
    rows = samples(lambda f: {"acc": f}, lambda w: {"gyro": w})
    document = {"units": {"acc": "g", "gyro": "deg/s"}, "samples": rows}
    with pytest.raises(imucal.FormatError, match=r"states these units: units.acc = g, units.gyro = deg/s"):
        read(tmp_path, document)
    lines = [json.dumps({"units": document["units"]}), *map(json.dumps, rows)]
    with pytest.raises(imucal.FormatError, match=r"states these units: units.acc = g"):
        imucal.read(write(tmp_path, "run.jsonl", lines))
    columns = ",".join(f"accel_{a}_g=acc.{a},gyro_{a}_dps=gyro.{a}" for a in "xyz")
    recording = read(tmp_path, document, columns=columns)
    check(recording)
    assert any("units.gyro = deg/s" in own.message for own in recording.findings)


@pytest.mark.parametrize(
    "texts", [TEXTS, {"note": "two\nlines, one comma"}, {"note": "\ud800"}, {"note": "\0"}]
)
@pytest.mark.parametrize("first", [0, 200])
def test_members_with_texts_are_left_out(tmp_path, texts, first):
    rows = samples(lambda f: {"acc_g": f}, lambda w: {"gyro_dps": w})
    rows = [texts | row | ({"state": "warm up"} if at < first else {}) for at, row in enumerate(rows)]
    check(read(tmp_path, rows))
    named = [
        texts | {"sensor": name, "t": ns, **xyz(own)}
        for ns, *pair in zip(NS.tolist(), FORCE.tolist(), RATE.tolist(), strict=True)
        for name, own in zip(("accelerometer", "gyroscope"), pair, strict=True)
    ]
    check(read(tmp_path, named, gyro_unit="rad/s"))


def test_a_line_feed_in_the_name_of_a_member(tmp_path):
    check(read(tmp_path, samples(lambda f: {"acc\n(g)": f}, lambda w: {"gyro\n(deg/s)": w})))


def test_numbers_in_texts_and_a_text_among_the_numbers(tmp_path):
    rows = samples(lambda f: {"acc (g)": xyz(f)}, lambda w: {"gyro (dps)": xyz(w)})
    texts = [
        {
            name: xyz(map(str, own.values())) if isinstance(own, dict) else str(own)
            for name, own in row.items()
        }
        for row in rows
    ]
    check(read(tmp_path, texts))
    recording = read(tmp_path, [rows[0] | {"acc (g)": xyz(["ERR", 0.0, 1.0])}, *rows])
    assert next(own.code for own in recording.findings if own.count == 1) == "lines_left_out"
