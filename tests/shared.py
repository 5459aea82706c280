"""What many tests need and takes long is computed once in a run, whichever process of it asks first."""

import fcntl
import os
import pickle
from collections.abc import Callable
from functools import wraps
from pathlib import Path
from typing import Any, TypeVar, cast

T = TypeVar("T", bound=Callable[..., Any])

# Directory of the whole run, which conftest.py sets.
DIRECTORY = "CPAM_BAYES_TEST_RUN"


def once_a_run(function: T) -> T:
    """The function, its results pickled for all processes of the run; a second one waits for the first.

    Arguments must have a ``repr`` that names them. Within a process a result is one object.
    """
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
