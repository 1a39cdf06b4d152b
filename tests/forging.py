"""Results folders as somebody would leave them who knows how they are made: digests and all."""

import json

from dssc_jax.results.blocks import Chunks
from dssc_jax.results.digests import DIGESTS, digest_of_all
from dssc_jax.results.manifest import SEAL, read_manifest, stored_layout, write_manifest
from dssc_jax.study import Study


def resealed(folder, **changes):
    """The manifest with some of its fields replaced (None: taken away), and its digest taken anew."""
    manifest = json.loads((folder / "manifest.json").read_text()) | changes
    write_manifest(folder, {name: value for name, value in manifest.items() if name != SEAL and value is not None})


def redigested(folder):
    """Digests of whatever the arrays now hold."""
    manifest = read_manifest(folder)
    study = Study.from_table(manifest["study"])
    layout = stored_layout(folder, study, manifest)
    chunks = Chunks(folder, study, layout, "r+")
    for block in layout.blocks():
        held = {name: chunks.arrays[name][block[-1:] if name in study.laws else block] for name in chunks.arrays}
        chunks.write(block, held, {})
    resealed(folder, **{DIGESTS: digest_of_all(folder, layout)})
