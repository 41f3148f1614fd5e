#!/bin/sh
# Calibrates one unit, judges it by limits.json, and moves its calibration file to passed/ or rejected/.
#
#   production_line.sh SERIAL RUN.CSV CONTROL.CSV
#
# The exit codes are those of imucal: 0 passed, 1 no result, 2 rejected.
set -u
serial=$1 run=$2 control=$3

# The serial number is used in file names.
case $serial in
    ''|.*|*/*) echo "the serial number is '$serial': read it again" >&2; exit 1 ;;
esac

# Removes the results of an earlier calibration of the same unit.
mkdir -p passed rejected results || exit 1
rm -f -- "$serial.json" "passed/$serial.json" "rejected/$serial.json" "results/$serial.json" || exit 1

imucal calibrate "$run" --control "$control" --serial-number "$serial" --limits limits.json \
    -o "$serial.json" --json "results/$serial.json"
code=$?
case $code in
    0) mv -- "$serial.json" passed || exit 1; echo "$serial: passed" ;;
    2) mv -- "$serial.json" rejected || exit 1; echo "$serial: rejected" ;;
    *) echo "$serial: no result, record again" ;;
esac
exit $code
