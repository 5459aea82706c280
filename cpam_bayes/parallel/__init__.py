"""Work shared out over any ``concurrent.futures.Executor``: processes, threads, a Dask cluster."""

from cpam_bayes.parallel.executors import WorkersLostError, open_executor, read_spec
from cpam_bayes.parallel.sharing import run

__all__ = ["WorkersLostError", "open_executor", "read_spec", "run"]
