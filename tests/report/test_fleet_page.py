"""The page of a fleet and the certificate of a unit."""

import re

import numpy as np
import pytest

import imucal
from imucal.fleet.judging import Judging
from imucal.report import calibration_hash, write_certificate, write_fleet_page
from planted_fleet import planted_fleet


class PlantedFleet(Judging):
    """A store in memory."""

    path = "planted"

    def __init__(self, measurements, same=()):
        self._measurements, self._same = measurements, list(same)

    def measurements(self, **_):
        return self._measurements

    def query(self, sql, arguments=()):
        raise NotImplementedError

    def failures(self, **_):
        return {"samples_missing": 3}

    def same_recordings(self, **_):
        return self._same

    def count(self, **_):
        return {"good": len(self._measurements), "failed": 3}


@pytest.mark.slow
@pytest.mark.parametrize("units", [60, 600])
def test_the_page_has_the_same_size_for_any_number_of_units(units, tmp_path):
    planted = planted_fleet(units=units, dates=2, drifting=4, odd=2, shift=3.0)
    write_fleet_page(tmp_path / "fleet.html", PlantedFleet(planted.measurements))
    page = (tmp_path / "fleet.html").read_text()
    assert len(page) < 2.5e6
    assert f"{2 * units} of {2 * units + 3} calibrations pass" in page
    assert "samples_<wbr>missing" in page
    for serial in planted.odd:
        assert f'href="#unit-{serial}"' in page and f'<details id="unit-{serial}"' in page
    # Nothing is loaded from elsewhere.
    assert not re.search(r'(src|href)="(?!#)', page)
    assert 'id="figure-time-gyro_bias_x"' in page


def test_a_small_fleet_has_a_page_with_the_reasons(tmp_path):
    planted = planted_fleet(units=4, dates=1, drifting=0, odd=0)
    write_fleet_page(tmp_path / "fleet.html", PlantedFleet(planted.measurements))
    page = (tmp_path / "fleet.html").read_text()
    assert "control charts need 10" in page and "the search for outliers needs" in page
    # Without an alarm, units without a result still show, and a test that was not made is no passed test.
    assert 'class="verdict incomplete"' in page
    assert "no alarm; not tested: shifts of stations, odd units" in page
    write_fleet_page(tmp_path / "same.html", PlantedFleet(planted.measurements, [["U1", "U2"]]))
    page = (tmp_path / "same.html").read_text()
    assert 'class="verdict poor"' in page and "1 recording under several serial numbers" in page
    assert "U1 and U2" in page
    with pytest.raises(imucal.InputError, match="nothing to report"):
        write_fleet_page(
            tmp_path / "none.html", PlantedFleet(planted.measurements.where(np.zeros(4, dtype=bool)))
        )


def test_a_certificate(tmp_path):
    bare = imucal.Calibration(
        accelerometer=imucal.Triad(np.eye(3), np.zeros(3)),
        gyroscope=imucal.Triad(np.diag([1.0, 1.02, 0.98]), (0.01, 0.0, 0.0)),
        serial_number="<0042>".strip("<>"),
        provenance=imucal.Provenance(
            files=(imucal.Source("/data/run-0042.csv", "ab" * 32),), imucal_version="0.1.0", date="2026-11-26"
        ),
    )
    names = tuple(parameter.name for parameter in bare.parameters)
    calibration = imucal.Calibration(
        **{
            **{
                name: getattr(bare, name)
                for name in ("accelerometer", "gyroscope", "serial_number", "provenance")
            },
            "covariance": 1e-8 * np.eye(len(names)),
            "covariance_names": names,
        }
    )
    limits = imucal.Limits(
        (
            imucal.ParameterLimit("gyro_bias_*", "rad/s", -0.005, 0.005),
            imucal.ParameterLimit("gyro_sensitivity_yy", "1", 0.97, 1.03),
        )
    )
    write_certificate(tmp_path / "0042.html", calibration, limits=limits, conditions={"station": "A<1>"})
    page = (tmp_path / "0042.html").read_text()
    assert "Unit 0042: poor" in page and "A&lt;1&gt;" in page
    # 0.01 rad/s is 0.573 deg/s; 1.02 is 20000 ppm, with 1 sigma of 100 ppm, of -30000 to 30000 ppm.
    row = re.search(r"gyro_<wbr>bias_<wbr>x.*?</tr>", page)[0]
    assert "0.5730" in row and "0.0057" in row and "deg/s" in row and "FAIL" in row
    row = re.search(r"gyro_<wbr>sensitivity_<wbr>yy.*?</tr>", page)[0]
    assert "yy − 1" in row and "20000" in row and "-30000 to 30000" in row and "pass" in row
    assert "run-0042.csv" in page and "ab" * 32 in page
    # A reader of a certificate cannot know that standard deviations exclude an error of gravity.
    assert "9.80665 m/s², standard gravity was assumed; its error is not included in 1 σ" in page
    assert "taken as exact; its error is not included in 1 σ" in page
    assert calibration_hash(calibration) in page
    assert calibration_hash(calibration) != calibration_hash(bare)
    assert "script" not in page
