"""Runs of a fleet on Dask, and a lambda over `imucal.calibrate` on Dask and joblib, with real processes."""

import sys
import time
from dataclasses import replace

import joblib
import pytest
from distributed import Client, LocalCluster

import imucal
from fleet.dask_processes import Cluster
from fleet.killing import check, start
from fleet.simulated import plan, write_manifest, write_one, write_poison

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="processes are killed and found by /proc"),
]
UNITS = 16


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Recordings of UNITS units, the last of which ends the process that reads it."""
    made = tmp_path_factory.mktemp("fleet")
    planned = [replace(each, bad=None) for each in plan(2000)[0][:UNITS]]
    planned[-1] = replace(planned[-1], bad="poisoned")
    for each in planned:
        (made / each.date).mkdir(exist_ok=True)
        write_one(made, each)
    write_manifest(made / "manifest.csv", planned)
    write_poison(made / "sitecustomize")
    return made


@pytest.fixture(scope="module")
def client():
    """A notebook's cluster: two processes of this computer."""
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as connected,
    ):
        yield connected


def test_a_lambda_runs_on_dask_and_joblib(folder, client):
    paths = [str(path) for path in sorted(folder.glob("*/0000[0-3]-*.npz"))]
    alone = [imucal.calibrate(imucal.read(path)).parameters for path in paths]
    futures = client.map(lambda path: imucal.calibrate(imucal.read(path)), paths)
    assert [result.parameters for result in client.gather(futures)] == alone
    parallel = joblib.Parallel(n_jobs=2)
    results = parallel(
        joblib.delayed(lambda path: imucal.calibrate(imucal.read(path)))(path) for path in paths
    )
    assert [result.parameters for result in results] == alone


def test_a_run_on_a_client_equals_one_on_processes(folder, client, tmp_path):
    stores = [imucal.Fleet(tmp_path / name) for name in ("dask.sqlite", "local.sqlite")]
    tallies = [stores[0].run(folder / "manifest.csv", scheduler=client, total=UNITS)]
    tallies.append(stores[1].run(folder / "manifest.csv", workers=1))
    assert [tally.verdicts for tally in tallies] == [{"good": UNITS}] * 2
    first, second = (store.measurements(covariances=True) for store in stores)
    assert first.serials.tolist() == second.serials.tolist()
    assert (first.values_si == second.values_si).all()
    assert (first.covariances == second.covariances).all()


def test_a_poisoned_file_and_a_lost_scheduler(folder, tmp_path):
    store = tmp_path / "units.sqlite"
    with Cluster(tmp_path, workers=2, start_files=folder / "sitecustomize") as cluster:
        run = start(
            store,
            folder / "manifest.csv",
            scheduler=cluster.address,
            total=UNITS,
            start_files=folder / "sitecustomize",
        )
        assert run.wait() == 0, run.output.read_text()
        assert imucal.Fleet(store).count() == {"good": UNITS - 1, "poisoned": 1}

        lost = tmp_path / "lost.sqlite"
        run = start(lost, folder / "manifest.csv", scheduler=cluster.address, total=UNITS)
        run.wait_for(1)
        cluster.kill_scheduler()
        run.wait()
        said = run.output.read_text()
        assert "is lost" in said or "done" in said, said
        stored = check(lost, run.told)
    rest = start(lost, folder / "manifest.csv", workers=1, total=UNITS)
    assert rest.wait() == 0
    assert check(lost, rest.told) == UNITS
    assert f"done {UNITS - stored} {stored}" in rest.output.read_text()


def test_no_scheduler_is_an_error(folder, tmp_path):
    start_s = time.monotonic()
    with pytest.raises(imucal.ImucalError, match="no scheduler answers"):
        imucal.Fleet(tmp_path / "units.sqlite").run(
            [str(next(folder.glob("*/00000-*.npz")))], scheduler="tcp://127.0.0.1:9"
        )
    assert time.monotonic() - start_s < 120
