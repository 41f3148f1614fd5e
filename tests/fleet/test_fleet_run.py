"""Runs of a fleet with real processes: nothing twice, poisoned files, kills, two parents, a full disk."""

import contextlib
import json
import signal
import subprocess
import sys
import time

import pytest

import imucal
import imucal.cli.live_page as live_page
from children import HANGS_S, heed_signals
from fleet.killing import check, kill, start, workers_of
from imucal.fleet.job import keyed
from imucal.fleet.local import Ended
from imucal.fleet.outcome import Outcome
from imucal.fleet.run import run_jobs
from imucal.fleet.store import Store
from small_fleet import UNITS

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="processes are killed and found by /proc"),
]


# Longest time of a unit, s, also on a computer with much other work.
LIMIT_S = 30.0


def counts(store):
    return imucal.Fleet(store).count()


def test_a_second_run_computes_nothing(small_fleet, tmp_path):
    fleet = imucal.Fleet(tmp_path / "units.sqlite")
    told = []
    first = fleet.run(
        small_fleet / "good.csv", workers=1, tell=lambda job, *rest: told.append((job.serial, *rest))
    )
    assert (first.units, first.done, first.skipped, first.failed) == (UNITS, UNITS, 0, 1)
    assert len(told) == UNITS
    assert [code for _, verdict, code, _ in told if verdict == "failed"] == ["format"]
    second = fleet.run(small_fleet / "good.csv", workers=1)
    assert (second.done, second.skipped, second.failed) == (0, UNITS, 1)
    assert second.verdict == first.verdict == "no_result"
    # Other options are other jobs, and the last one of a recording is current.
    third = fleet.run(small_fleet / "good.csv", workers=1, calibrate={"gravity_mps2": 9.81})
    assert (third.done, third.skipped) == (UNITS, 0)
    assert sum(fleet.count().values()) == UNITS
    assert fleet.calibration("00000").gravity_mps2 == 9.81
    # What has no result is tried again only on request.
    again = fleet.run(small_fleet / "good.csv", workers=1, retry=True)
    assert (again.done, again.skipped) == (1, UNITS - 1)


def test_a_recording_that_is_given_twice_is_stored_once(small_fleet, tmp_path):
    (path,) = small_fleet.glob("*/00001-*.npz")
    jobs = [imucal.fleet.job.Job("1", (str(path),)), imucal.fleet.job.Job("2", (str(path),))] * 2
    jobs.append(imucal.fleet.job.Job("3", (str(tmp_path / "none.npz"),)))
    fleet, told = imucal.Fleet(tmp_path / "units.sqlite"), []
    # A new store takes the keys from the processes that read the files, the second run computes them itself.
    for done, skipped in ((2, 2), (0, 4)):
        told.clear()
        tally = fleet.run(jobs, workers=1, tell=lambda job, *rest: told.append((job.serial, *rest[:2])))
        assert (tally.done, tally.skipped, tally.unreadable) == (done, skipped, 1)
        assert ("3", "failed", "file_missing") in told
        assert fleet.count() == {"good": 2, "failed": 1}
        assert fleet.same_recordings() == [["1", "2"]] and fleet.same_recordings(serial="2") == []
        assert fleet.failures() == {"file_missing": 1} and fleet.failures(serial="1") == {}
    with imucal.fleet.store.Store(tmp_path / "units.sqlite") as store:
        assert not store.is_new


def test_another_run_makes_a_store_an_old_one(small_fleet, tmp_path):
    (path,) = small_fleet.glob("*/00001-*.npz")
    with imucal.fleet.store.Store(tmp_path / "units.sqlite") as store:
        assert store.is_new
        imucal.Fleet(tmp_path / "units.sqlite").run([path], workers=1)
        assert not store.is_new


def test_a_poisoned_file_costs_its_own_row_alone(small_fleet, tmp_path):
    store = tmp_path / "units.sqlite"
    run = start(store, small_fleet / "poisoned.csv", start_files=small_fleet / "sitecustomize")
    assert run.wait() == 0, run.output.read_text()
    assert counts(store) == {"good": UNITS - 2, "failed": 1, "poisoned": 1}
    ((serial, code, message),) = imucal.Fleet(store).rows(("serial", "code", "message"), verdict="poisoned")[
        1
    ]
    assert (serial, code) == ("00017", "poisoned")
    assert "ends by SIGSEGV without an answer, in 3 attempts when nothing else runs" in message
    again = start(store, small_fleet / "poisoned.csv", start_files=small_fleet / "sitecustomize")
    assert again.wait() == 0
    assert f"done 0 {UNITS}" in again.output.read_text()


def test_a_recording_that_hangs_costs_its_own_row_alone(small_fleet, tmp_path):
    store = tmp_path / "units.sqlite"
    run = start(
        store, small_fleet / "hanging.csv", start_files=small_fleet / "sitecustomize", time_limit_s=LIMIT_S
    )
    assert run.wait() == 0, run.output.read_text()
    assert counts(store) == {"good": UNITS - 2, "failed": 2}
    rows = dict(imucal.Fleet(store).rows(("code", "message"), serial="00017")[1])
    assert "longer than the time limit of 30 s" in rows["time_limit"]
    # The limit is not part of a job's key, so another limit computes nothing.
    again = imucal.Fleet(store).run(small_fleet / "hanging.csv", workers=1, time_limit_s=60.0)
    assert (again.done, again.skipped) == (0, UNITS)
    with pytest.raises(imucal.InputError, match="time_limit_s is 0"):
        imucal.Fleet(store).run(small_fleet / "hanging.csv", time_limit_s=0.0)


class KilledFromOutside:
    """A pool without processes, whose first work ends without an answer, as if it was killed from outside."""

    processes = capacity = 1

    def __init__(self, ends):
        self.ends, self.works = ends, []

    def submit(self, work):
        self.works.append(work)

    def next(self):
        self.ends -= 1
        work = self.works.pop()
        if self.ends >= 0:
            return work, Ended()
        keys = [keyed(job, work.options.text) for job in work.jobs]
        return work, [Outcome(each, "failed", "format", "x") for each in keys]

    def close(self):
        pass


@pytest.mark.parametrize(("ends", "verdict"), [(1, "failed"), (3, "failed"), (4, "poisoned")])
def test_a_worker_that_is_killed_from_outside_poisons_nothing(small_fleet, tmp_path, ends, verdict):
    (path,) = small_fleet.glob("*/00003-*.npz")
    job = imucal.fleet.job.Job("0003", (str(path),))
    with Store(tmp_path / "units.sqlite") as store:
        run_jobs(store, [job], imucal.fleet.job.Options(), lambda: KilledFromOutside(ends), total=1)
    # The first end is that of the task, and three attempts follow it.
    assert counts(tmp_path / "units.sqlite") == {verdict: 1}


@pytest.mark.parametrize("told", [0, 1, 7, 15])
def test_a_killed_parent_loses_nothing_that_it_told(small_fleet, tmp_path, told):
    store = tmp_path / "units.sqlite"
    run = start(store, small_fleet / "good.csv", total=UNITS)
    run.wait_for(told)
    run.process.kill()
    run.wait()
    before = check(store, run.told)
    assert before < UNITS or told >= 15
    rest = start(store, small_fleet / "good.csv", total=UNITS)
    assert rest.wait() == 0, rest.output.read_text()
    assert check(store, rest.told) == UNITS
    assert f"done {UNITS - before} {before}" in rest.output.read_text()


def test_killed_workers_are_replaced(small_fleet, tmp_path):
    store = tmp_path / "units.sqlite"
    run = start(store, small_fleet / "good.csv", total=UNITS)
    killed = 0
    for told in (1, 5, 10):
        run.wait_for(told)
        killed += sum(map(kill, workers_of(run.process.pid)))
    assert run.wait() == 0, run.output.read_text()
    assert killed
    assert check(store, run.told) == UNITS
    assert counts(store) == {"good": UNITS - 1, "failed": 1}


def test_two_parents_share_a_store(small_fleet, tmp_path):
    store = tmp_path / "units.sqlite"
    runs = [start(store, small_fleet / "good.csv", workers=1, total=UNITS) for _ in range(2)]
    assert [run.wait() for run in runs] == [0, 0], [run.output.read_text() for run in runs]
    assert check(store, [serial for run in runs for serial in run.told]) == UNITS
    assert counts(store) == {"good": UNITS - 1, "failed": 1}


def test_a_full_disk_says_what_is_stored(small_fleet, tmp_path):
    store = tmp_path / "units.sqlite"
    run = start(store, small_fleet / "good.csv", total=UNITS, limit_bytes=120_000)
    assert run.wait() == 1
    said = run.output.read_text()
    assert "cannot be used as a store" in said
    assert "free space on its disk, and run the same command again" in said
    stored = check(store, run.told)
    assert f"{stored} outcomes of this run are stored" in said
    rest = start(store, small_fleet / "good.csv", total=UNITS)
    assert rest.wait() == 0
    assert check(store, rest.told) == UNITS


def test_parts_of_a_run_are_merged(small_fleet, tmp_path, command):
    stores = [tmp_path / f"part-{part}.sqlite" for part in (1, 2, 3)]
    for part, store in enumerate(stores, 1):
        done = command(
            "fleet", "run", store, small_fleet / "good.csv", "--shard", f"{part}/3", "--workers", 1
        )
        assert done.returncode in (0, 1), done.stderr
        assert sum(counts(store).values()) == UNITS // 3
    done = command("fleet", "merge", tmp_path / "all.sqlite", *stores)
    assert f"{UNITS} rows taken, {UNITS} units now" in done.stdout, done.stderr
    # Merging again takes nothing, and the merged store knows all jobs.
    assert imucal.Fleet(tmp_path / "all.sqlite").merge(*stores) == 0
    tally = imucal.Fleet(tmp_path / "all.sqlite").run(small_fleet / "good.csv", workers=1)
    assert (tally.done, tally.skipped) == (0, UNITS)
    calibration = imucal.Fleet(tmp_path / "all.sqlite").calibration("00001")
    alone = imucal.calibrate(imucal.read(next(small_fleet.glob("*/00001-*.npz"))))
    assert (calibration.covariance == alone.calibration.covariance).all()
    assert [p.value for p in calibration.parameters] == [p.value for p in alone.parameters]


def test_a_changed_file_is_another_job(small_fleet, tmp_path):
    source = next(small_fleet.glob("*/00003-*.npz"))
    path = tmp_path / "0003.npz"
    path.write_bytes(source.read_bytes())
    fleet = imucal.Fleet(tmp_path / "units.sqlite")
    assert fleet.run([path], workers=1).done == 1
    path.unlink()
    gone = fleet.run([imucal.fleet.job.Job("0003", (str(path),))], workers=1)
    assert (gone.done, gone.unreadable, gone.codes["file_missing"]) == (0, 1, 1)
    path.write_bytes(next(small_fleet.glob("*/00004-*.npz")).read_bytes())
    assert fleet.run([path], workers=1).done == 1
    # The failure of the missing file is gone, and both recordings are measurements of the unit.
    assert fleet.count() == {"good": 2}


def test_ctrl_c_ends_a_run_and_its_processes(small_fleet, tmp_path):
    store = tmp_path / "units.sqlite"
    run = start(store, small_fleet / "good.csv", total=UNITS)
    run.wait_for(1)
    workers = workers_of(run.process.pid)
    run.process.send_signal(signal.SIGINT)
    run.wait()
    check(store, run.told)
    assert workers
    assert not [worker for worker in workers if worker in workers_of(1) and kill(worker)]


def test_a_watched_folder_is_taken_as_files_come(small_fleet, tmp_path):
    watched, store, document = tmp_path / "in", tmp_path / "units.sqlite", tmp_path / "run.json"
    watched.mkdir()
    sources = [next(small_fleet.glob(f"*/{number:05}-*.npz")) for number in range(2)]
    words = ["-m", "imucal", "fleet", "run", store, "--watch", watched, "--workers", "1", "--json", document]
    words += ["--report", tmp_path / "fleet.html"]
    process = subprocess.Popen(
        [sys.executable, *map(str, words)], stdout=subprocess.DEVNULL, preexec_fn=heed_signals
    )
    for number, source in enumerate(sources):
        (watched / f"run-{number:04}.npz").write_bytes(source.read_bytes())
        wait_until(lambda expected=number + 1: store.exists() and counts(store) == {"good": expected})
    process.send_signal(signal.SIGINT)
    assert process.wait(HANGS_S) == 0
    done = json.loads(document.read_text())
    assert (done["units"], done["done"], done["skipped"]) == (2, 2, 0)
    # The last page is complete, so a browser does not load it again.
    page = (tmp_path / "fleet.html").read_text()
    assert "2 of 2 calibrations pass" in page and 'http-equiv="refresh"' not in page


def test_the_page_is_written_while_a_run_goes_on(small_fleet, tmp_path, monkeypatch):
    store, page = tmp_path / "units.sqlite", tmp_path / "fleet.html"
    imucal.Fleet(store).run([next(small_fleet.glob("*/00001-*.npz"))], workers=1)
    monkeypatch.setattr(live_page, "RELOAD_S", 1.0)
    live = live_page.LivePage(store, page, None)
    live.step()
    wait_until(page.exists)
    live.close()
    assert '<meta http-equiv="refresh" content="1">' in page.read_text()


def wait_until(holds):
    end_s = time.monotonic() + HANGS_S
    while time.monotonic() < end_s:
        # The store is being made.
        with contextlib.suppress(imucal.ImucalError):
            if holds():
                return
        time.sleep(0.1)
    raise AssertionError("the folder is not watched")
