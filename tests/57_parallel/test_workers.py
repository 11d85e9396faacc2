"""Parts on the processes of a dask cluster give the same bits for any number of processes, even if one dies."""

from __future__ import annotations

import operator
import os
import signal
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import fg_orient as fg
from fg_orient.adjustment.loop import OPTIMIZERS
from fg_orient.adjustment.parts import dissection, execution
from fg_orient.adjustment.parts import pool as pool_module
from fg_orient.adjustment.parts.backend import PartedBackend
from fg_orient.adjustment.parts.execution import Execution, opened, work_folder
from fg_orient.adjustment.parts.parts import read_part
from fg_orient.adjustment.parts.pool import Cluster, Pool, branches, summed, tree
from fg_orient.adjustment.parts.study import study
from fg_orient.adjustment.parts.tasks import forget
from fg_orient.adjustment.problem import Problem, State, compile_problem
from fg_orient.adjustment.solve import solve
from fg_orient.model.block import Block
from fg_orient.simulate.block import BlockOptions, grid_block
from tests.support.full_statistics import step_of_numpy

from .conftest import certificate_of

PARTS = 4


class Few(Cluster):
    """The first few workers of a cluster, and no others."""

    def __init__(self, client: Any, count: int) -> None:
        super().__init__(client)
        self.count = count

    def workers(self) -> list[str]:
        return super().workers()[: self.count]


class Deadly(Cluster):
    """The task ends the process of a worker in the middle of each of the given first tasks, once each."""

    def __init__(self, client: Any, marks: Path, when: Sequence[int]) -> None:
        super().__init__(client)
        self.marks, self.when, self.calls = marks, when, 0

    def total(self, task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Any:
        return super().total(*self._deadly(task, arguments))

    def each(self, task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]) -> Iterator[tuple[int, Any]]:
        return super().each(*self._deadly(task, arguments))

    def _deadly(
        self, task: Callable[..., Any], arguments: Sequence[tuple[Any, ...]]
    ) -> tuple[Callable[..., Any], Sequence[tuple[Any, ...]]]:
        self.calls += 1
        if self.calls not in self.when:
            return task, arguments
        mark = self.marks / str(self.calls)

        def once(number: int, *rest: Any) -> Any:
            found = task(*rest)
            if number == 1 and not mark.exists():
                mark.touch()
                os._exit(9)
            return found

        return once, [(number, *rest) for number, rest in enumerate(arguments)]


def run(problem: Problem, pool: Pool, optimizer: str = "gauss-newton") -> State:
    """Adjust on a pool."""
    with work_folder(Execution(), pool) as folder:
        backend = PartedBackend(problem, pool, folder, PARTS)
        result = OPTIMIZERS[optimizer](backend, backend.initial(), 50)
        assert result.converged
        return State(result.state.image, result.state.ground)


@pytest.fixture(scope="module")
def alone(problem: Problem) -> State:
    """Return the solution of the parts in this process."""
    return run(problem, Pool())


def assert_same_bits(a: State, b: State) -> None:
    np.testing.assert_array_equal(a.image, b.image)
    np.testing.assert_array_equal(a.ground, b.ground)


@pytest.mark.consistency
@pytest.mark.parametrize("count", [1, 2])
def test_the_bits_do_not_depend_on_the_number_of_workers(
    problem: Problem, client: Any, alone: State, count: int
) -> None:
    assert_same_bits(run(problem, Few(client, count)), alone)


@pytest.mark.consistency
@pytest.mark.slow
@pytest.mark.parametrize("count", [3, 4])
def test_nor_of_more_workers(problem: Problem, four: Any, alone: State, count: int) -> None:
    assert_same_bits(run(problem, Few(four, count)), alone)


@pytest.mark.consistency
@pytest.mark.parametrize("count", [1, 2, 3, 7, 8])
def test_branches_are_those_of_the_tree(count: int) -> None:
    """Sums of branches of any depth add in the order of the whole tree.

    The summands are words, which show the order.
    """
    arguments = [(k,) for k in range(count)]

    class Word(str):
        def __add__(self, other: str) -> Word:
            return Word(f"({self}{other})")

    whole = summed(lambda k: Word(k), arguments)
    for depth in range(5):
        found = branches(arguments, depth)
        assert [a for branch in found for a in branch] == arguments
        sums = iter([summed(lambda k: Word(k), branch) for branch in found])
        assert tree(arguments, depth, lambda branch, sums=sums: next(sums)) == whole


@pytest.mark.oracle
def test_workers_agree_with_one_piece(small: Block, problem: Problem, client: Any) -> None:
    """A run on workers has the solution of one process within 1e-9 prior sigma and 1e-7 m, and no step left."""
    whole, shared = solve(problem), fg.adjust(small, parts=PARTS, cluster=client)
    assert shared.status == fg.Status.CONVERGED
    image, ground = step_of_numpy(problem, shared.state)
    assert image <= 1e-9 and ground <= 1e-7
    assert np.abs(shared.state.image - whole.state.image).max() <= 1e-9
    assert np.nanmax(np.abs(shared.state.ground - whole.state.ground)) <= 1e-7


@pytest.mark.consistency
def test_workers_that_die_change_nothing(problem: Problem, client: Any, alone: State, tmp_path: Path) -> None:
    """If a worker ends during its elimination, another one repeats its work and the result has the same bits."""
    deadly = Deadly(client, tmp_path, (3,))
    before = set(client.run(os.getpid).values())
    assert_same_bits(run(problem, deadly), alone)
    assert [p.name for p in tmp_path.iterdir()] == ["3"]
    assert len(before - set(client.run(os.getpid).values())) == 1


@pytest.mark.slow
@pytest.mark.consistency
def test_fronts_do_not_depend_on_the_workers(
    problem: Problem, client: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fronts have the same bits on any number of workers, also if workers end that have eliminated images."""
    for name in ("HELD", "SMALLER"):
        monkeypatch.setattr(dissection, name, 0.0)
    alone = run(problem, Pool())
    for pool in (Few(client, 1), Cluster(client), Deadly(client, tmp_path, (1, 2))):
        assert_same_bits(run(problem, pool), alone)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["1", "2"]


@pytest.mark.consistency
@pytest.mark.slow
def test_a_worker_killed_between_tasks_changes_nothing(small: Block, four: Any) -> None:
    shared, seen = fg.adjust(small, parts=PARTS, optimizer="dogleg"), []

    def kill(record: Any) -> None:
        seen.append(record.iteration)
        if record.iteration == 2:
            os.kill(min(four.run(os.getpid).values()), signal.SIGKILL)

    with certificate_of(four) as address:  # a client of its own, as the command line has
        killed = fg.adjust(small, parts=PARTS, optimizer="dogleg", cluster=address, callback=kill)
    assert_same_bits(killed.state, shared.state)
    assert 2 in seen


@pytest.mark.consistency
@pytest.mark.slow
def test_a_large_block_on_workers_that_die(four: Any, tmp_path: Path) -> None:
    """A block of 1e5 image points has the same bits on any workers, two of them killed, and the result of one part."""
    large, _ = grid_block(BlockOptions(rows=6, columns=6, points=29_000, seed=2))
    problem = compile_problem(replace(large, options=replace(large.options, eop_set=20, backend="schur")))
    assert len(problem.observations) > 1e5
    whole, alone = solve(problem), run(problem, Pool())
    assert np.abs(alone.image - whole.state.image).max() <= 1e-9
    assert np.nanmax(np.abs(alone.ground - whole.state.ground)) <= 1e-7
    for pool in (Few(four, 1), Few(four, 2), Cluster(four), Deadly(four, tmp_path, (3, 6))):
        assert_same_bits(run(problem, pool), alone)
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.behaviour
def test_faults_come_back_from_a_worker_in_words(client: Any, tmp_path: Path) -> None:
    with pytest.raises(fg.InputError) as caught:
        Cluster(client).total(read_part, [(str(tmp_path / "elsewhere"), 0)])
    assert caught.value.problems[0].code == "parallel.folder"
    assert caught.value.problems[0].file.endswith("part-0000.npz")


@pytest.mark.behaviour
def test_workers_share_a_study(client: Any) -> None:
    assert study(partial(operator.mul, 3), [5, 1, 4], cluster=client) == [15, 3, 12]


@pytest.mark.behaviour
def test_own_processes_answer_on_this_machine_with_a_certificate_only(client: Any) -> None:
    """Scheduler and workers listen on 127.0.0.1 only and refuse a client without the right certificate."""
    import distributed

    with certificate_of(client) as address:
        assert all(one.startswith("tls://127.0.0.1:") for one in (address, *client.scheduler_info()["workers"]))
        strangers: list[tuple[str, dict[str, Any]]] = [
            (address.replace("tls://", "tcp://"), {}), (address, {"security": distributed.Security.temporary()}),
        ]  # fmt: skip
        for place, more in strangers:
            with pytest.raises(OSError):
                distributed.Client(place, timeout=5, set_as_default=False, **more)
        with distributed.Client(address, timeout=30, set_as_default=False) as own:  # by the configuration
            assert own.submit(operator.add, 1, 2).result() == 3


@pytest.mark.behaviour
def test_the_end_of_every_worker_is_said() -> None:
    """If dask reports a killed worker, the error has the code ``parallel.killed`` and the worker's address."""
    lost = pytest.importorskip("distributed").KilledWorker("task", "tcp://127.0.0.1:9", 1)
    with pytest.raises(fg.NoSolutionError) as caught, pool_module._failures():
        raise lost
    assert (caught.value.problems[0].code, caught.value.problems[0].value) == ("parallel.killed", "tcp://127.0.0.1:9")


@pytest.mark.behaviour
@pytest.mark.slow
def test_work_that_ends_every_worker_is_given_up(client: Any) -> None:
    def allow(failures: int, dask_scheduler: Any) -> int:
        before, dask_scheduler.allowed_failures = dask_scheduler.allowed_failures, failures
        return before

    before = client.run_on_scheduler(allow, 0)
    with pytest.raises(fg.NoSolutionError) as caught:
        Cluster(client).total(os._exit, [(1,)])
    client.run_on_scheduler(allow, before)
    assert caught.value.problems[0].code == "parallel.killed"


@pytest.mark.behaviour
def test_what_is_missing_is_said(small: Block, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "CONNECT_S", 0.3)
    for address in ("tcp://127.0.0.1:9", "nonsense://x"):
        with pytest.raises(fg.InputError) as caught:
            fg.adjust(small, cluster=address)
        assert caught.value.problems[0].code == "parallel.unreachable"
    monkeypatch.setattr(execution, "find_spec", lambda name: None)
    with pytest.raises(fg.InputError) as caught:
        fg.adjust(small, workers=2)
    assert caught.value.problems[0].code == "parallel.dask"
    assert "fg-orient[cluster]" in caught.value.problems[0].remedy


@pytest.mark.behaviour
def test_one_worker_needs_no_dask(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(execution, "find_spec", lambda name: None)
    for workers in (0, 1):
        with opened(Execution(workers=workers)) as pool:
            assert isinstance(pool, Pool)
    forget("nowhere")
