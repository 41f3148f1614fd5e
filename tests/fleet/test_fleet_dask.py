"""Runs of a fleet on Dask, and a lambda over `imucal.calibrate` on Dask and joblib, with real processes."""

import sys

import joblib
import pytest
from distributed import Client, LocalCluster

import imucal
from engine import Engine
from fleet.dask_processes import Cluster
from fleet.killing import check, start
from imucal.fleet.cluster import DaskPool
from imucal.fleet.local import LocalPool
from small_fleet import UNITS

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="processes are killed and found by /proc"),
]

# Longest time of a unit, s. On a computer with much other work, the first unit of a new worker takes more
# than 5 s.
LIMIT_S = 30.0


@pytest.fixture(scope="module")
def client():
    """A notebook's cluster: two processes of this computer."""
    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as connected,
    ):
        yield connected


def test_a_lambda_runs_on_dask_and_joblib(small_fleet, client):
    paths = [str(path) for path in sorted(small_fleet.glob("*/0000[0-3]-*.npz"))]
    alone = [imucal.calibrate(imucal.read(path)).parameters for path in paths]
    futures = client.map(lambda path: imucal.calibrate(imucal.read(path)), paths)
    assert [result.parameters for result in client.gather(futures)] == alone
    parallel = joblib.Parallel(n_jobs=2)
    results = parallel(
        joblib.delayed(lambda path: imucal.calibrate(imucal.read(path)))(path) for path in paths
    )
    assert [result.parameters for result in results] == alone


def test_a_run_on_a_client_equals_one_on_processes(small_fleet, client, tmp_path):
    stores = [imucal.Fleet(tmp_path / name) for name in ("dask.sqlite", "local.sqlite")]
    tallies = [stores[0].run(small_fleet / "poisoned.csv", scheduler=client, total=UNITS)]
    tallies.append(stores[1].run(small_fleet / "poisoned.csv", workers=1))
    assert [tally.verdicts for tally in tallies] == [{"good": UNITS - 1, "failed": 1}] * 2
    first, second = (store.measurements(covariances=True) for store in stores)
    assert first.serials.tolist() == second.serials.tolist()
    assert (first.values_si == second.values_si).all()
    assert (first.covariances == second.covariances).all()


def test_a_benchmark_gives_the_same_answers_on_a_client_and_on_processes(client):
    def bias(seed):
        return imucal.Unit.random("bmi088", seed).gyroscope.bias.tolist()

    answers = []
    for pool in (lambda: DaskPool(client), lambda: LocalPool(2)):
        with Engine(pool, None) as engine:
            answers.append(list(engine.map(bias, range(9), name="bias")))
    assert answers[0] == answers[1] == [bias(seed) for seed in range(9)]


@pytest.fixture(scope="module")
def cluster(small_fleet, tmp_path_factory):
    """A scheduler and two workers that can be killed; a poisoned file ends or stops its reader there."""
    folder = tmp_path_factory.mktemp("cluster")
    with Cluster(folder, workers=2, start_files=small_fleet / "sitecustomize") as started:
        yield started


def test_a_recording_that_hangs_on_a_cluster_costs_its_own_row_alone(small_fleet, cluster, tmp_path):
    tally = imucal.Fleet(tmp_path / "units.sqlite").run(
        small_fleet / "hanging.csv", scheduler=cluster.address, time_limit_s=LIMIT_S
    )
    assert tally.verdicts == {"good": UNITS - 2, "failed": 2}
    assert tally.codes == {"format": 1, "time_limit": 1}


def test_a_poisoned_file_costs_its_own_row_alone(small_fleet, cluster, tmp_path):
    store = tmp_path / "units.sqlite"
    run = start(
        store,
        small_fleet / "poisoned.csv",
        scheduler=cluster.address,
        total=UNITS,
        start_files=small_fleet / "sitecustomize",
    )
    assert run.wait() == 0, run.output.read_text()
    assert imucal.Fleet(store).count() == {"good": UNITS - 2, "failed": 1, "poisoned": 1}


def test_a_lost_scheduler_loses_nothing_that_was_told(small_fleet, cluster, tmp_path):
    """The last test of the cluster, because it kills it."""
    lost = tmp_path / "lost.sqlite"
    run = start(lost, small_fleet / "poisoned.csv", scheduler=cluster.address, total=UNITS)
    run.wait_for(1)
    cluster.kill_scheduler()
    run.wait()
    said = run.output.read_text()
    assert "is lost" in said or "done" in said, said
    stored = check(lost, run.told)
    rest = start(lost, small_fleet / "poisoned.csv", workers=1, total=UNITS)
    assert rest.wait() == 0
    assert check(lost, rest.told) == UNITS
    assert f"done {UNITS - stored} {stored}" in rest.output.read_text()


def test_no_scheduler_is_an_error():
    with pytest.raises(imucal.ImucalError, match="no scheduler answers within 1 s"):
        DaskPool("tcp://127.0.0.1:9", connect_s=1.0)
