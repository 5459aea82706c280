"""Long work: a time limit ends it with the best answer so far, and BLAS uses a single thread."""

from concurrent.futures import ThreadPoolExecutor
from contextlib import nullcontext
from itertools import count
from threading import Barrier, Event, current_thread
from typing import Any

import numpy as np
import pytest
from threadpoolctl import threadpool_info, threadpool_limits

import cpam_bayes as cb
from cpam_bayes import running
from cpam_bayes.answer import Verdict
from cpam_bayes.inference.ensemble import EnsembleSettings
from cpam_bayes.parallel import run
from cpam_bayes.questions import sequence
from cpam_bayes.running import TimeIsUpError, cut_short, is_time_up, single_blas_thread, time_limit
from tests.answers import CHAINS, SWARM, answered
from tests.stacking.cases import STEP, TRUE, listed

AT_ONCE = 1e-9


@pytest.fixture
def looks(monkeypatch):
    seconds = count()
    monkeypatch.setattr(running.time, "monotonic", lambda: float(next(seconds)))


def left_out(answer: cb.Result) -> dict[str, Any]:
    """Missing parts according to an answer's first notice: code -> facts."""
    first, *_ = answer.notices or (None,)
    return {} if first is None or first.code != "time_up" else dict(first.facts["missing"])


def plus_one(shared: int, item: int) -> int:
    assert not is_time_up()
    return shared + item


def test_time_is_up_after_the_limit_and_never_without(looks):
    assert not is_time_up()
    with time_limit(2.0):
        assert [is_time_up() for _ in range(3)] == [False, True, True]
        with time_limit(None):
            assert not is_time_up()
        assert is_time_up()
    assert not is_time_up()
    for seconds in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="time limit: received"), time_limit(seconds):
            pass


def test_what_is_missing_is_noted_once():
    cut_short("nobody asked")
    with time_limit(5.0):
        cut_short("this", done=1)
        cut_short("this", done=1)
        assert running.current_limit().missing == [("this", {"done": 1})]


@pytest.mark.parametrize("executor", [None, ThreadPoolExecutor(1)])
def test_limited_work_ends_between_two_items(looks, executor):
    told = []
    asked = {"batch_size": 1, "on_result": lambda *result: told.append(result), "is_limited": True}
    with time_limit(3.0), pytest.raises(TimeIsUpError, match=r"the time limit of 3 s .* of 50 parts"):
        run(plus_one, 1, range(50), executor, **asked)
    assert 0 < len(told) < 50  # work begun at the end of the time is reported too
    with time_limit(3.0):
        assert run(plus_one, 1, range(50)) == list(range(1, 51))


def test_a_swarm_in_time_gives_the_same_and_late_ends_early_with_status_1_and_says_so_first(run):
    free = answered("identify")
    with time_limit(3600.0):
        limited = cb.identify("A1", seed=1)
    assert (limited.reached_goal, limited.constants, limited.slips) == (True, free.constants, free.slips)
    with time_limit(AT_ONCE):
        point = cb.identify("A1", seed=0)
    assert (point.reached_goal, point.status, set(point.constants)) == (False, "budget", {"E1", "nu12"})
    assert point.slips[0] == point.warnings[0]
    assert left_out(point) == {"cut_swarm": {"done": 0, "of": 400}, "cut_swarms": {"done": 1, "of": 3}}
    status, out, err = run("identify", "A1", "--quiet", "--time-limit", "1e-9")
    assert status == 1
    assert "warning: The time limit of 1e-09 s" in err
    assert "The time limit of 1e-09 s ended the work early" in out.splitlines()[1]
    status, out, err = run("sensitivity", "A1", "--quiet", "--executor", "serial", "--time-limit", "1e-9")
    assert (status, out) == (1, "")
    assert err.startswith("error: the time limit of 1e-09 s was reached before there was an answer")


def test_emcee_ends_after_a_round_and_goes_on_from_the_store(tmp_path):
    with time_limit(AT_ONCE):
        cut = cb.sample("A1", seed=0, store=tmp_path, settings=EnsembleSettings(round_steps=20))
    assert (cut.reached_goal, left_out(cut)["cut_chains"]) == (False, {"done": 20, "of": 10000})
    assert list(tmp_path.glob("*"))
    assert {c.verdict for c in (*cut.constants.values(), *cut.sizes.values())} == {Verdict.UNCONVERGED}
    said, headline = cut.report().summary, "The chains did not converge: do not use this answer."
    assert (said.headline, said.next_step) == (headline, "allow more time: --time-limit S.")
    assert "determine" not in cut.summary()


@pytest.mark.slow
def test_nothing_is_claimed_of_a_part_of_the_causes_and_others_are_named(run, plate_file):
    plain = cb.forward(plate_file()).frequencies[:6]
    for factors in (np.ones(6), np.linspace(0.94, 1.06, 6)):
        listed = ", ".join(f"{f:.2f}" for f in plain * factors)
        plate = plate_file(("114, 167, 218, 289, 300, 497]", f"{listed}]\nrelative_std = 0.002"))
        status, out, _ = run("diagnose", plate, "--time-limit", AT_ONCE, "--executor", "serial")
        assert status == 1
        assert "time was up before every cause was tested" in out
        with time_limit(AT_ONCE):
            answer = cb.diagnose(plate)
        assert (answer.claim, answer.reached_goal) == ("undecided", False)
        not_tested, missing = answer.diagnosis.weighed.not_tested, left_out(answer)
        assert len(not_tested) == missing["cut_hypotheses"]["count"] > 0
        assert all("time was up" in text for text in not_tested)
        assert "cut_gain" in missing
        assert "thickness" in missing["cut_hypotheses"]["causes"]
        tested = {t.hypothesis.cause for t in answer.diagnosis.weighed.tested}
        assert tested & {"none", "other", "thickness"} == {"none", "other"}


class Told(running.Watch):
    def __init__(self) -> None:
        self.told: list[int] = []

    def stage(self, *args: Any, **options: Any) -> Any:
        return nullcontext(running.Progress(lambda k, value: self.told.append(k), lambda text: None))


@pytest.mark.slow
@pytest.mark.parametrize("done", [2, pytest.param(4, marks=pytest.mark.weekly)])
def test_a_noise_study_has_the_groups_that_were_inverted(done, monkeypatch):
    asked = {"levels": [0.01, 0.05], "groups": 4, "readings": ["rms"], "settings": SWARM, "chains": CHAINS}
    whole, watch = cb.sensitivity("A1", **asked), Told()
    up = 2 * (done + 1) + (done < 4)
    monkeypatch.setattr("cpam_bayes.parallel.sharing.is_time_up", lambda: len(watch.told) >= up)
    with time_limit(3600.0):
        cut = cb.sensitivity("A1", **asked, watch=watch)
    for a, b in zip(cut.study.cells, whole.study.cells, strict=True):
        assert a.repetition.constants.tolist() == b.repetition.constants[:done].tolist()
    missing = {"cut_groups": {"done": 2, "of": 4}} if done == 2 else {}
    assert (cut.reached_goal, left_out(cut)) == (done == 4, missing)


def test_plates_that_a_batch_did_not_reach_have_rows_that_say_so():
    with time_limit(AT_ONCE):
        answer = cb.batch("A1", "no such plate", "A2")
    assert (answer.reached_goal, [row.status for row in answer.rows]) == (False, ["failed"] * 3)
    assert [row.message == "time was up before this plate" for row in answer.rows] == [True, False, True]
    assert left_out(answer) == {"cut_plates": {"late": 2, "of": 3}}


@pytest.mark.slow
def test_sequences_are_all_weighed_or_have_no_probability_and_the_first_is_sampled_always(monkeypatch):
    plate = listed("[?/?]_s", STEP, TRUE, 0.02)
    with time_limit(AT_ONCE), pytest.raises(TimeIsUpError, match="before there was an answer"):
        cb.sequence(plate)
    whole, sample_mixture, missing = cb.sequence(plate, seed=0), sequence.sample_mixture, []

    def late(*args: Any, **kwargs: Any) -> Any:
        with time_limit(AT_ONCE):
            mixture = sample_mixture(*args, **kwargs)
            missing.append(running.current_limit())
            return mixture

    monkeypatch.setattr(sequence, "sample_mixture", late)
    cut, n = cb.sequence(plate, seed=0), len(whole.mixture.components)
    assert n > len(cut.mixture.components) == 1
    assert missing[0].missing[0] == ("cut_sequences", {"done": 1, "of": n})
    assert cut.answer.probability.tolist() == whole.answer.probability.tolist()
    first, same = (answer.mixture.components[0].draws for answer in (whole, cut))
    assert first.tolist() == same.tolist()


def blas_threads() -> int:
    return max(info["num_threads"] for info in threadpool_info() if info["user_api"] == "blas")


@pytest.fixture
def two_threads():
    with threadpool_limits(2, user_api="blas"):
        assert blas_threads() == 2
        yield


def test_the_limit_is_lifted_at_the_end_of_the_outer_function_even_of_a_failure(two_threads):
    inner = single_blas_thread(blas_threads)

    @single_blas_thread
    def fail() -> None:
        assert (inner(), blas_threads()) == (1, 1)
        raise LookupError

    with pytest.raises(LookupError):
        fail()
    assert blas_threads() == 2


def test_the_last_thread_to_leave_lifts_the_limit_and_no_other(two_threads):
    both_in, first_is_out = Barrier(2), Event()

    @single_blas_thread
    def second() -> int:
        both_in.wait(60)
        first_is_out.wait(60)
        return blas_threads()

    with ThreadPoolExecutor(2) as pool:
        last = pool.submit(second)
        pool.submit(single_blas_thread(both_in.wait), 60).result(60)
        first_is_out.set()
        assert last.result(60) == 1
    assert blas_threads() == 2


def test_a_stack_is_shared_out_but_by_workers_with_the_answer_of_a_thread(two_threads, monkeypatch):
    matrices, shares = np.random.default_rng(3).normal(size=(101, 30, 30)), []
    matrices += matrices.swapaxes(1, 2)

    def counted(stack):
        shares.append((len(stack), current_thread().name))
        return np.linalg.eigvalsh(stack)

    def fails_at_the_end(stack):
        if stack[-1, 0, 0] == matrices[-1, 0, 0]:
            raise np.linalg.LinAlgError("no convergence")
        return counted(stack)

    monkeypatch.setattr(running, "cores", lambda: 3)
    with running.keep_to_one_core():
        running.matrix_by_matrix(counted, matrices)
    assert {name for _, name in shares} == {current_thread().name}
    shares.clear()
    np.testing.assert_array_equal(running.matrix_by_matrix(counted, matrices), np.linalg.eigvalsh(matrices))
    sizes, names = zip(*shares, strict=True)
    assert sorted(sizes) == [33, 34, 34]
    assert len(set(names)) > 1
    with pytest.raises(np.linalg.LinAlgError, match="no convergence"):
        running.matrix_by_matrix(fails_at_the_end, matrices)
