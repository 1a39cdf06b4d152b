"""Studies: reading a TOML file into a validated closed loop with its laws, axes and requirements."""

from dssc_jax.study.described import Described, stored_study
from dssc_jax.study.laws import Law
from dssc_jax.study.study import Study, hash_of, takes_file
from dssc_jax.study.tables import read_toml

__all__ = ["Described", "Law", "Study", "hash_of", "read_toml", "stored_study", "takes_file"]
