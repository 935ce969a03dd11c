"""Campaigns: the same numbers whoever computes them, nothing lost whatever happens, and mistakes said in a sentence."""

import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from small_campaign import SMALL, numbers, same, small_campaign

from sims.physics.imu import accel_matrix, gyro_matrix, is_imu
from sims.physics.sequences import TABLE_1
from sims.robustness import trial
from sims.robustness.campaign import drawn_prior, load_campaign
from sims.robustness.result_folder import ResultFolder, schema
from sims.robustness.run import run_campaign
from sims.robustness.trial import OUTCOMES, run_trial, score
from sims.scenarios.scenario import load_scenario
from sims.scenarios.simulation import simulate
from srt.closed_form.estimator import estimate_units
from srt.comparison.parallel import Engine, _ended_managers_are_silent
from srt.constants import DEG
from srt.exceptions import DataError, InputError
from srt.sensor_errors import GROUP_SLICES, SensorErrors


@pytest.fixture
def small(tmp_path):
    return partial(small_campaign, tmp_path)


# The same numbers


@pytest.mark.slow
def test_dask_gives_the_same_numbers(small, tmp_path):
    distributed = pytest.importorskip("distributed")
    campaign = small(trials=2)
    here = run_campaign(campaign, tmp_path / "here")
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, processes=True, dashboard_address=None, silence_logs=50
    ) as cluster:
        there = run_campaign(campaign, tmp_path / "there", engine=Engine(scheduler=cluster.scheduler_address))
    assert same(here, there)


FILTERS = """
[[estimator]]
name = "ekf"
label = "wide"

[[estimator]]
name = "ekf"
label = "drawn"
prior = "drawn"
"""


def test_the_prior_of_the_drawn_errors(small):
    """±5 % uniform is a sigma of 5/√3 %; errors that are not drawn have no such prior."""
    text = SMALL.replace('[[estimator]]\nname = "closed-form"\n', FILTERS)
    campaign = small(text=text)
    assert [e.drawn_prior for e in campaign.estimators] == [False, True]
    sigma = np.sqrt(np.diag(drawn_prior(campaign.unit(0, 0)[0]).covariance))
    np.testing.assert_allclose(sigma[GROUP_SLICES["gyro_scale"]], 0.05 / np.sqrt(3.0), rtol=1e-12)
    np.testing.assert_allclose(sigma[GROUP_SLICES["accel_misalignment"]], 0.03 / np.sqrt(3.0), rtol=1e-12)
    recording = simulate(campaign.unit(0, 0)[0])
    wide, drawn = (score(recording, choice, fixed_point=False) for choice in campaign.estimators)
    assert len(wide["nis"]) == len(drawn["nis"]) == len(TABLE_1)
    # The narrower prior expects smaller innovations of the first sequence.
    assert drawn["nis"][0] > 10.0 * wide["nis"][0]
    with pytest.raises(InputError, match="gyro_bias is not drawn"):
        small(text=text.replace("low = 0.0, high = 1.0", "low = 0.0, high = 0.0"))
    with pytest.raises(InputError, match="has the prior 'wide'"):
        small(text=text.replace('prior = "drawn"', 'prior = "wide"'))


def test_more_trials_leave_those_before_alone(small, tmp_path):
    few = run_campaign(small(trials=1), tmp_path / "a")
    more = run_campaign(small(trials=2), tmp_path / "a")
    assert same(more.slice(0, few.num_rows), few)
    fewer_again = run_campaign(small(trials=1), tmp_path / "a")
    assert same(fewer_again, few)


def test_axes_mean_what_they_say(small):
    campaign = small(extra="accel_bias_mg = { low = 100.0, high = 100.0 }\nasymmetry_ppm = { choices = [500] }\n")
    bounds = {"gyro_scale": 0.5, "accel_scale": 0.5, "gyro_orthogonality": 0.03, "accel_misalignment": 0.03}
    bounds |= {"accel_bias": 0.1 * 9.80665, "gyro_asymmetry": 5e-4, "accel_asymmetry": 5e-4, "gyro_bias": 1.0 * DEG}
    drawn = np.array([simulate(campaign.unit(1, k)[0]).truth.vector for k in range(40)])
    for group, bound in bounds.items():
        part = np.abs(drawn[:, GROUP_SLICES[group]])
        assert part.max() <= bound
        # Of at least 120 even draws one lies in the outermost tenth (probability of none 0.9^120 = 3e-6).
        assert part.max() > 0.9 * bound or group == "gyro_bias"  # whose bound is drawn itself


def test_dwells_stay_with_their_sequences(small):
    """Every sequence with a start window of its own length: left out or repeated, it keeps it."""
    dwells = [1.0 + 0.1 * k for k in range(len(TABLE_1))]
    text = SMALL.replace("dwell_s = 2.0", f"dwells_s = {dwells}")
    campaign = small(extra="missing_sequences = { choices = [2] }\nrepeated_sequences = { choices = [3] }\n", text=text)
    schedule = campaign.unit(0, 0)[0].schedule
    own = dict(zip(load_scenario("robustness").schedule.sequences, dwells, strict=True))
    assert (len(schedule.sequences), len(set(schedule.sequences))) == (18, 15)
    assert schedule.dwells_s == tuple((own[name],) * 2 for name in schedule.sequences)


# Scores


def test_errors_of_no_imu_are_told():
    for group, values in {"gyro_scale": [-1.1, 0.0, 0.0], "accel_scale": [0.0, -0.9, 0.0]}.items():
        vector = np.zeros(27)
        vector[GROUP_SLICES[group]] = values
        errors = SensorErrors(vector)
        singular = [np.linalg.svd(M)[1].min() for M in (gyro_matrix(errors), accel_matrix(errors))]
        assert min(singular) < 0.15
        assert not is_imu(errors)
    assert is_imu(SensorErrors())


def test_impossible_units_are_counted_and_not_calibrated(small):
    text = SMALL.replace("[5, 50]", "[200]")
    campaign = small(text=text)
    rows = [run_trial(campaign, (0, k))[0] for k in range(12)]
    told = [row["outcome"] == "no_imu" for row in rows]
    assert told == [not is_imu(simulate(campaign.unit(0, k)[0]).truth) for k in range(12)]
    assert any(told)
    assert all("status" not in row for row, t in zip(rows, told, strict=True) if t)


def test_a_wrong_minimum_is_called_one(small, monkeypatch):
    """An estimator that says converged where it stopped, and not where an iteration from the truth does."""
    campaign = small()

    def careless(recordings, options):
        out = []
        for found, own in zip(estimate_units(recordings, options), options, strict=True):
            vector = found.errors.vector.copy()
            if own.start == "auto":
                vector[0] += 2e-8 + 0.02 * found.sigma[0]
            out.append(replace(found, errors=SensorErrors(vector)))
        return out

    monkeypatch.setattr(trial, "estimate_units", careless)
    (row,) = run_trial(campaign, (0, 0))
    assert row["outcome"] == "wrong_minimum"
    assert row["distance"] > 1.0


@pytest.mark.parametrize(
    ("error", "outcome", "said"),
    [
        (DataError("No."), "refused", "No."),
        (ValueError("array must not contain infs"), "crashed", "ValueError: array must not contain infs"),
    ],
)
def test_an_error_is_an_outcome_of_its_estimator_alone(small, monkeypatch, error, outcome, said):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("srt.calibrate", fail)
    failed, other = run_trial(small(extra='[[estimator]]\nname = "least-squares"\n'), (0, 0))
    assert (failed["outcome"], failed["message"]) == (outcome, said)
    assert other["outcome"] == "converged"
    assert failed["seed"] == other["seed"]


def test_starts_that_only_campaigns_have(small):
    extra = '[[estimator]]\nname = "closed-form"\nlabel = "{0}"\nstart = "{0}"\n'
    campaign = small(extra=extra.format("truth") + extra.format("unguided") + extra.format("zero"))
    rows = {row["estimator"]: row for row in run_trial(campaign, (1, 0))}
    assert set(rows) == {"truth", "unguided", "zero", "closed-form"}
    assert {row["outcome"] for row in rows.values()} <= set(OUTCOMES)
    for name in ("truth", "zero", "closed-form"):
        assert rows[name]["outcome"] == "converged"
    assert rows["truth"]["playbacks"] <= rows["closed-form"]["playbacks"]


# Nothing is lost


@pytest.mark.slow
def test_a_campaign_that_was_killed_goes_on(small, tmp_path):
    """Killed outright in the middle; every trial it had finished is there, and the rest comes out as it would have."""
    campaign = small(trials=6)
    whole = run_campaign(campaign, tmp_path / "whole", engine=Engine(1))
    folder = tmp_path / "killed"
    command = [sys.executable, "-m", "srt.cli", "robustness", str(tmp_path / "small.toml"), "-o", str(folder)]
    process = subprocess.Popen([*command, "--workers", "1", "--quiet"], start_new_session=True)
    journal = folder / "journal.jsonl"
    deadline = time.monotonic() + 60.0
    try:
        while not (journal.exists() and journal.read_bytes().count(b"\n") >= 3):
            assert process.poll() is None, "it ended before it could be killed"
            assert time.monotonic() < deadline
            time.sleep(0.01)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    finished = journal.read_bytes().count(b"\n")
    assert 3 <= finished < 12
    with journal.open("ab") as file:
        file.write(b'[{"point": 1, "repl')  # as a line that was being written
    with ResultFolder(folder, campaign) as store:
        assert len(store.done) == finished
    again = []
    table = run_campaign(campaign, folder, progress=lambda done, size: again.append((done, size)))
    assert again[0] == (finished, 12)
    assert same(table, whole)


def test_a_journal_that_became_a_part_counts_once(small, tmp_path):
    campaign = small()
    rows = run_trial(campaign, (0, 0))
    with ResultFolder(tmp_path / "a", campaign) as store:
        store.add(rows)
    kept = (tmp_path / "a" / "journal.jsonl").read_bytes()
    with ResultFolder(tmp_path / "a", campaign):
        pass  # the journal is a part now
    (tmp_path / "a" / "journal.jsonl").write_bytes(kept)  # killed between the two steps
    with ResultFolder(tmp_path / "a", campaign) as store:
        assert store.table().num_rows == 1


@pytest.mark.parametrize("stored", ["journal", "part"])
def test_a_flipped_bit_changes_no_result_in_silence(small, tmp_path, stored):
    """At 25 places: the results are as they were computed, are to be computed again, or are refused."""
    campaign, folder = small(), tmp_path / "a"
    with ResultFolder(folder, campaign) as store:
        for key in ((0, 0), (0, 1), (1, 0)):
            store.add(run_trial(campaign, key))
        computed = numbers(store.table())
    journal = folder / "journal.jsonl"
    kept = journal.read_bytes()
    with ResultFolder(folder, campaign):
        pass  # the journal is a part now
    (part,) = (folder / "parts").glob("*.parquet")
    path, content = (journal, kept) if stored == "journal" else (part, part.read_bytes())
    rng = np.random.default_rng(20261122)
    for place in rng.integers(len(content), size=25):
        for old in (folder / "parts").glob("*.parquet"):
            old.unlink()
        damaged = bytearray(content)
        damaged[place] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged)
        try:
            with ResultFolder(folder, campaign) as store:
                found = numbers(store.table())
        except InputError:
            continue
        assert all(row in computed for row in found)
        assert len(found) == len(computed) or stored == "journal"


def test_results_of_another_campaign_are_not_mixed(small, tmp_path):
    campaign = small()
    run_campaign(campaign, tmp_path / "a")
    other = replace(campaign, seed=8)
    with pytest.raises(InputError, match=r"another campaign.*--fresh"):
        run_campaign(other, tmp_path / "a")
    assert run_campaign(other, tmp_path / "a", fresh=True).num_rows == 4


def test_two_runs_do_not_write_to_one_folder(small, tmp_path):
    with (
        ResultFolder(tmp_path / "a", small()),
        pytest.raises(InputError, match="Another run is writing"),
    ):
        ResultFolder(tmp_path / "a", small())


def test_a_broken_part_is_named(small, tmp_path):
    run_campaign(small(), tmp_path / "a")
    (part,) = (tmp_path / "a" / "parts").glob("*.parquet")
    part.write_bytes(part.read_bytes()[:100])
    with pytest.raises(InputError, match=r"part-000001.*remove it"):
        run_campaign(small(), tmp_path / "a")


def test_the_table_has_the_columns_that_are_promised(small, tmp_path):
    extra = 'grade = { choices = ["tactical-fog", "industrial-mems"] }\n'
    extra += '"schedule.leg_dwell_s" = { low = 0, high = 1 }\n'
    campaign = small(trials=1, extra=extra)
    table = run_campaign(campaign, tmp_path / "a")
    assert table.schema == schema(campaign)
    for axis in campaign.axes:
        assert axis in table.column_names
    assert set(table["grade"].to_pylist()) <= {"tactical-fog", "industrial-mems"}


# Mistakes


MISTAKES = {
    "unknown axis": ("[grid]", "[grid]\nscale_percnt = [1]", "did you mean scale_percent"),
    "unknown key": ("[grid]", '[grid]\n"schedule.dwel_s" = [1]', "did you mean 'dwell_s'"),
    "unknown campaign key": ("seed = 7", "seed = 7\ntrails = 3", "did you mean 'trials'"),
    "no seed": ("seed = 7\n", "", "'seed' is missing"),
    "number in quotes": ("[5, 50]", '["5"]', "give a number"),
    "empty list": ("[5, 50]", "[]", "scale_percent"),
    "negative": ("[5, 50]", "[-5]", "not below 0"),
    "both kinds": ("[random]", "[random]\nscale_percent = { low = 0, high = 1 }", "keep one"),
    "low above high": ("low = 0.0, high = 1.0", "low = 2.0, high = 1.0", "low is above high"),
    "half a range": ("low = 0.0, high = 1.0", "low = 2.0", "give either low and high, or choices"),
    "log of zero": ("high = 1.0 }", "high = 1.0, log = true }", "log needs a low above 0"),
    "unknown estimator": ('name = "closed-form"', 'name = "closed"', "closed-form"),
    "unknown option": ('name = "closed-form"', 'name = "closed-form"\nstrat = "zero"', "did you mean start"),
    "bad option": ('name = "closed-form"', 'name = "closed-form"\nstart = "nowhere"', "start"),
    "twice a label": ("[[estimator]]", '[[estimator]]\nname = "closed-form"\n[[estimator]]', "label of its own"),
    "no estimator": ("[[estimator]]", "[estimator]", "estimator"),
    "errors off": ('draw = "uniform"', 'draw = "none"', "no effect"),
    "too many missing": ("[grid]", "[grid]\nmissing_sequences = [17]", "leave one at least"),
    "no such scenario": ('from = "robustness"', 'from = "robust"', "no shipped scenario"),
    "no such grade": ("[grid]", '[grid]\ngrade = ["tactical"]', "no shipped imu"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_is_one_sentence(mistake, tmp_path):
    old, new, said = MISTAKES[mistake]
    text = SMALL.format(trials=1, extra="", scenario="")
    assert old in text
    (tmp_path / "bad.toml").write_text(text.replace(old, new, 1))
    with pytest.raises(InputError) as error:
        load_campaign(tmp_path / "bad.toml")
    sentence = str(error.value)
    assert sentence.startswith("bad.toml: ") or "no shipped" in sentence
    assert said in sentence
    assert "\n" not in sentence


# Engines


def test_missing_scheduler_is_reported(small, tmp_path, monkeypatch):
    pytest.importorskip("distributed")
    monkeypatch.setattr("srt.comparison.parallel._CONNECT_S", 0.5)
    with pytest.raises(InputError, match="No Dask scheduler answers at"):
        run_campaign(small(), tmp_path / "a", engine=Engine(scheduler="tcp://127.0.0.1:9"))


def test_another_service_at_the_address_of_a_scheduler_is_reported(small, tmp_path, monkeypatch):
    """Dask takes its first bytes as the length of a message, and asks for so much memory."""
    pytest.importorskip("distributed")
    monkeypatch.setattr("srt.comparison.parallel._CONNECT_S", 0.5)
    with socket.create_server(("127.0.0.1", 0)) as server:

        def answer():
            with suppress(OSError):
                while True:
                    connection = server.accept()[0]
                    connection.sendall(b"HTTP/1.1 400 Bad Request\r\nContent-Length: 0\r\n\r\n")
                    connection.close()

        threading.Thread(target=answer, daemon=True).start()
        address = f"tcp://127.0.0.1:{server.getsockname()[1]}"
        with pytest.raises(InputError, match="No Dask scheduler answers at"):
            run_campaign(small(), tmp_path / "a", engine=Engine(scheduler=address))


@pytest.mark.skipif(not Path("/proc/self/stat").exists(), reason="processes are looked up in /proc")
def test_workers_end_with_their_parent(tmp_path):
    """A parent killed outright cannot end its workers: they look for it."""
    (tmp_path / "waiting.py").write_text(
        "import os, pathlib, sys, time\nfrom srt.comparison.parallel import Engine\n"
        "def wait(i):\n    pathlib.Path(__file__).with_name(f'{os.getpid()}.pid').touch()\n    time.sleep(60.0)\n"
    )
    script = "import waiting; list(waiting.Engine(2).run(waiting.wait, range(2)))"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(tmp_path), *sys.path])}
    process = subprocess.Popen([sys.executable, "-c", script], cwd=tmp_path, env=environment)
    deadline = time.monotonic() + 60.0
    try:
        while len(list(tmp_path.rglob("*.pid"))) < 2:
            assert process.poll() is None
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        process.kill()
        process.wait()
    workers = [int(path.stem) for path in tmp_path.rglob("*.pid")]
    while any(_runs(worker) for worker in workers):
        assert time.monotonic() < deadline
        time.sleep(0.05)


def test_a_run_that_is_given_up_needs_no_advice_of_joblib(recwarn):
    """As on a full disk, which its own sentence explains."""
    results = Engine(2).run(abs, range(1000))
    next(results)
    results.close()
    assert [str(each.message) for each in recwarn] == []


@pytest.mark.parametrize(("workers", "said"), [(-1, "-1"), (100_000, "100000, but this machine has")])
def test_numbers_of_workers_that_no_machine_has_are_refused(workers, said):
    with pytest.raises(InputError, match=said):
        Engine(workers)


def _runs(process):
    """A process that has not ended; zombies that wait for init to collect them have."""
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except (FileNotFoundError, ProcessLookupError):
        return False


def test_a_foreign_file_among_the_parts_is_left_alone(small, tmp_path):
    campaign = small(trials=2)
    whole = run_campaign(campaign, tmp_path / "a")
    foreign = tmp_path / "a" / "parts" / "part-notes.parquet"
    foreign.write_bytes(b"notes")
    assert run_campaign(campaign, tmp_path / "a").equals(whole)
    assert foreign.read_bytes() == b"notes"


def die(_):
    os.kill(os.getpid(), signal.SIGKILL)


@pytest.mark.filterwarnings("ignore:A worker stopped:UserWarning")
def test_a_worker_that_dies_is_said():
    with pytest.raises(DataError, match="what finished before is kept"):
        list(Engine(2).run(die, range(4)))


@pytest.mark.parametrize("killed", [True, False])
def test_a_manager_of_killed_workers_ends_without_a_traceback(killed, monkeypatch):
    """An interruption prints one sentence; what ends another thread is still told."""
    told = []
    monkeypatch.setattr(threading, "excepthook", told.append)

    def fail():
        raise KeyError(5)

    with _ended_managers_are_silent():
        thread = threading.Thread(target=fail)
        thread.executor_flags = SimpleNamespace(kill_workers=killed)
        thread.start()
        thread.join()
    assert len(told) == (not killed)
    assert threading.excepthook == told.append
