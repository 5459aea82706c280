"""Slow shared results of many tests, computed once per run by whichever process needs them first."""

import fcntl
import hashlib
import os
import pickle
import re
from collections import OrderedDict
from collections.abc import Callable
from functools import wraps
from inspect import isfunction
from pathlib import Path
from typing import Any, TypeVar, cast

T = TypeVar("T", bound=Callable[..., Any])

DIRECTORY = "CPAM_BAYES_TEST_RUN"  # Environment variable with the directory of the run, set by conftest.py.


def once_a_run(function: T) -> T:
    """Decorator that pickles results for all processes of the run; a second process waits for the first.
    Arguments must have a ``repr`` that identifies them. Within a process a result is a single object."""
    here: dict[str, Any] = {}

    @wraps(function)
    def shared(*args: object) -> Any:
        name = f"{function.__module__}.{function.__qualname__}{args!r}".replace("/", "|")
        if name not in here:
            path = Path(os.environ[DIRECTORY], f"{name}.pickle")
            with open(path.with_suffix(".lock"), "w") as lock:
                fcntl.flock(lock, fcntl.LOCK_EX)
                if not path.exists():
                    path.write_bytes(pickle.dumps(function(*args)))
                here[name] = pickle.loads(path.read_bytes())
        return here[name]

    return cast(T, shared)


class ModelsOfTheRun(OrderedDict[str, Any]):
    """Plate models shared by all processes of a run, in place of each process's own store.
    Models of effects outside the catalogue stay in the process: keys do not tell their functions apart."""

    def __init__(self, directory: Path) -> None:
        from cpam_bayes.effects import edges, effect, geometry, layup, masses, plies

        super().__init__()
        self._directory = directory
        modules = (edges, effect, geometry, layup, masses, plies)
        self._functions = {name for m in modules for name, f in vars(m).items() if isfunction(f)}

    def _path(self, key: str) -> Path | None:
        named = re.sub(r"<function ([\w.<>]+) at 0x[0-9a-f]+>", r"<\1>", key)
        if " at 0x" in named or not set(re.findall(r"<([\w.<>]+)>", named)) <= self._functions:
            return None
        return self._directory / f"{hashlib.sha256(named.encode()).hexdigest()}.pickle"

    def __contains__(self, key: object) -> bool:
        if super().__contains__(key):
            return True
        path = self._path(str(key))
        if path is None or not path.exists():
            return False
        super().__setitem__(str(key), pickle.loads(path.read_bytes()))
        return True

    def __setitem__(self, key: str, model: Any) -> None:
        super().__setitem__(key, model)
        path = self._path(key)
        if path is not None:
            own = path.with_suffix(f".{os.getpid()}")
            own.write_bytes(pickle.dumps(model))
            own.replace(path)
