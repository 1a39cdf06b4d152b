"""dssc-jax verify: some lanes of a result again, by the plain program."""

import json

from dssc_jax.cli.declarations.results import Verify
from dssc_jax.cli.exit_codes import DONE, FAILS
from dssc_jax.cli.loading import stored_result
from dssc_jax.console.draws import show_verification
from dssc_jax.results.summary import jsonable
from dssc_jax.runs.verify import verify


def run(options: Verify) -> int:
    """Compute the lanes again and print how far they deviate."""
    result = stored_result(options.result, options.trust_code, options.allow_local, options.allow_native)
    verification = verify(result, options.draws, options.seed)
    if options.as_json:
        print(json.dumps(jsonable({"result": str(options.result), **verification.to_dict()}), allow_nan=False))
    else:
        show_verification(verification)
    return DONE if verification.verified else FAILS
