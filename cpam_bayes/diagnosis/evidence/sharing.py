"""Work on hypotheses shared out over workers: they hold the plates' models and are sent all else."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from concurrent.futures import Executor
from io import BytesIO
from typing import Any, TypeVar

from cpam_bayes.diagnosis.fitting import PlateCase
from cpam_bayes.parallel import ProcessPool, run

Item = TypeVar("Item")
Answer = TypeVar("Answer")

Held = list[Any]


def shared_out(
    work: Callable[[Item], Answer],
    cases: Sequence[PlateCase],
    items: Sequence[Item],
    executor: Executor | None = None,
    *,
    common: Any = None,
    progress: Callable[[int], None] = lambda done: None,
) -> list[Answer]:
    """``work(item)`` of every item, in the order of the items, the same bit for bit on any executor.

    Items and answers may hold the models of the plates: a worker is sent these once and puts its copies in
    their place, and in the answers the models of this process come back. Where something cannot be sent, an
    effect of a script for instance, this process does the work itself.

    work : a function of a module
    common : what all items hold beside the models, sent once
    progress : is told the number of items that are done
    """
    held = [common, *_held(cases)]
    try:
        pickle.dumps(held)
        packed = [_packed(held, item) for item in items]
    except (pickle.PicklingError, AttributeError, TypeError):
        return [work(item) for item in items]
    done: list[int] = []

    def count(index: int, answer: bytes) -> None:
        done.append(index)
        progress(len(done))

    answers = run(_worked, (work, held), packed, executor, batch_size=1, on_result=count)
    return [_unpacked(held, answer) for answer in answers]


def ready(executor: Executor | None) -> None:
    """Let worker processes load what they need while this process has other work."""
    if isinstance(executor, ProcessPool):
        executor.start(_loaded)


def _loaded() -> None:
    """What a worker has done once it has this module."""


def _worked(shared: tuple[Callable[[Any], Any], Held], item: bytes) -> bytes:
    work, held = shared
    return _packed(held, work(_unpacked(held, item)))


def _held(cases: Sequence[PlateCase]) -> Held:
    """What stays where it is: models of the plates, and where a plate keeps them."""
    held: Held = []
    for case in cases:
        held += [case.models, case.models.bare, case.extended, *case.extended.values()]
        held.append(case.of_another_material)
        for models in case.of_another_material:
            held += [models, models.bare]
    return held


def _packed(held: Held, value: Any) -> bytes:
    """A pickle of a value, in which models that are held are numbers."""
    file = BytesIO()
    _Packer(file, held).dump(value)
    return file.getvalue()


def _unpacked(held: Held, packed: bytes) -> Any:
    """The value, with the models that are held in this process."""
    return _Unpacker(BytesIO(packed), held).load()


class _Packer(pickle.Pickler):
    def __init__(self, file: BytesIO, held: Held) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._number = {id(one): number for number, one in enumerate(held) if one is not None}

    def persistent_id(self, obj: Any) -> int | None:
        return self._number.get(id(obj))


class _Unpacker(pickle.Unpickler):
    def __init__(self, file: BytesIO, held: Held) -> None:
        super().__init__(file)
        self._held = held

    def persistent_load(self, pid: int) -> Any:
        return self._held[pid]
