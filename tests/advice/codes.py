"""The codes of all findings, from the sources of the library and of the package.

python tests/advice/codes.py        lists the codes that no test of advice covers
"""

import re
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
# Literals in the files that make findings which are no codes: columns, units and words of messages.
NO_CODES = re.compile(
    r"(accel|gyro)_[xyz]\w*|time_\w*s|temp_degc|lsb|mps2|radps|mradps|dps|mdps|dpmin|dph|rpm|gonps|ug|mg|g|s|ms|deg|samples|ratio|correlation|none|"
    r"short|long|sigma|three|six|sample|row|pairs|gap|interval|is|are|differs|differ|rests|once|"
    r"contradicts|accel|gyro|truth|above|below|accelerometer|gyroscope|degf|k|kelvin|hundredths|thousandths"
)


# Findings whose advice is tested elsewhere: those of readers, which do not change a calibration, and the
# check of a stand before a calibration.
ELSEWHERE = {
    "control_not_independent": "tests/estimation/test_independence.py",
    "control_outliers": "tests/estimation/test_control_coverage.py",
    "gyro_common_gain": "tests/estimation/test_references.py",
    "loose_mount": "tests/stand/test_calibrate.py",
    "temperature_extrapolated": "tests/estimation/test_evaluate.py",
    "already_corrected": "tests/io/test_logs.py",
    "board_rotated": "tests/io/test_logs.py",
    "file_damaged": "tests/io/test_logs.py",
    "tables_not_read": "tests/io/test_sensor_labels.py",
    "sensor_missing": "tests/estimation/test_accelerometer_alone.py",
    "counts_assumed": "tests/io/test_exports.py",
}


def codes() -> set[str]:
    """The codes of findings and diagnoses."""
    found: set[str] = set()
    for path in (ROOT / "rust" / "imucal" / "src").rglob("*.rs"):
        text = re.split(r"#\[cfg\(test\)\]\s*mod \w+ \{", path.read_text())[0]
        text = re.sub(r"//.*", "", text)
        if re.search(r"\bFinding::(error|warning)\b", text):
            found |= set(re.findall(r'"([a-z]+(?:_[a-z]+)*)"', text))
        found |= set(re.findall(r'\bcode: "(\w+)"', text))
    for path in (ROOT / "python" / "imucal").rglob("*.py"):
        text = path.read_text()
        found |= set(re.findall(r'\bcode="(\w+)"', text))
        found |= set(re.findall(r'\bremark\(\s*[\w.]+,\s*"(\w+)"', text))
    return {code for code in found if not NO_CODES.fullmatch(code)}


def tested() -> set[str]:
    """The codes that occur in the tests of this folder as `of_code("...")` or `Advised("...")`."""
    found = {code for code, path in ELSEWHERE.items() if code in (ROOT / path).read_text()}
    for path in Path(__file__).parent.glob("test_*.py"):
        found |= set(re.findall(r'(?:Advised|of_code)\(\s*"(\w+)"', path.read_text()))
    return found


if __name__ == "__main__":
    left = sorted(codes() - tested())
    print("\n".join(left) if left else "every finding has a test of its advice")
    sys.exit(bool(left))
