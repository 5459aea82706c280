"""Work in parallel over any ``concurrent.futures.Executor``: processes, threads, a Dask cluster."""

from cpam_bayes.parallel.executors import ProcessPool, WorkersLostError, observed, open_executor, read_spec
from cpam_bayes.parallel.sharing import counted, run

__all__ = ["ProcessPool", "WorkersLostError", "counted", "observed", "open_executor", "read_spec", "run"]
