"""Parallel work over any ``concurrent.futures.Executor``: processes, threads, a Dask cluster."""

from cpam_bayes.parallel.executors import ProcessPool, WorkersLostError, observed, open_executor, read_spec
from cpam_bayes.parallel.sharing import Lasting, counted, lasting, run

__all__ = [
    "Lasting",
    "ProcessPool",
    "WorkersLostError",
    "counted",
    "lasting",
    "observed",
    "open_executor",
    "read_spec",
    "run",
]
