"""Results of studies: datasets, their folders, and their summaries.

The folder of a run holds

* ``manifest.json``: the study as run, versions, device, counts and times, with a digest of itself and of all blocks
  (:mod:`~dssc_jax.results.manifest`);
* ``data.zarr``: an array for each metric, slack and drawn number, and for ``outcome``
  (:mod:`~dssc_jax.results.schema` names them, :mod:`~dssc_jax.results.arrays` creates and checks them);
* ``digests``: a file for each block of draws; it is written after the block's chunks and marks the block as complete
  (:mod:`~dssc_jax.results.digests`, :mod:`~dssc_jax.results.blocks`);
* ``summary.json``: failures, intervals and quantiles of every point, derived from the data and never read back
  (:mod:`~dssc_jax.results.summary`);
* ``.lock`` and ``.writer.json``: the lock of the process that writes, and its description
  (:mod:`~dssc_jax.results.lock`);
* ``proofs.json``, if the points of a sweep were proved (:mod:`~dssc_jax.results.proofs`).

:class:`~dssc_jax.results.store.Store` fills such a folder and resumes an interrupted run: blocks that match their
digests are kept, all others are computed again. The folder of an analysis holds the same kinds of files, with a
description ``NAME.json`` in place of the manifest (:mod:`~dssc_jax.results.analysis_folder`). Every reader checks the
digests. A folder of another schema version is refused.
"""
