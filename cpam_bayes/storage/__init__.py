"""Files that are whole or not there: drafts, checksums, stored arrays, and the cache of models."""

from cpam_bayes.storage.arrays import read_arrays, write_arrays
from cpam_bayes.storage.cache import cache_directory
from cpam_bayes.storage.drafts import draft_directory, draft_file, put_in_place, replaceable
from cpam_bayes.storage.sealed import read_sealed, seal_of, set_aside, write_sealed

__all__ = [
    "cache_directory",
    "draft_directory",
    "draft_file",
    "put_in_place",
    "read_arrays",
    "read_sealed",
    "replaceable",
    "seal_of",
    "set_aside",
    "write_arrays",
    "write_sealed",
]
