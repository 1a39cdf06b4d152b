"""dssc-jax plan: how many draws a question needs."""

import json

from dssc_jax.cli.declarations.statistics import Plan
from dssc_jax.cli.exit_codes import DONE
from dssc_jax.console.terminal import show_table
from dssc_jax.core.errors import ConfigError
from dssc_jax.statistics import plan


def run(options: Plan) -> int:
    """Print the numbers of draws."""
    try:
        answers = plan(options.error, options.confidence, options.probability)
    except ValueError as error:
        raise ConfigError("plan", str(error)) from None
    if options.as_json:
        question = {"error": options.error, "confidence": options.confidence, "probability": options.probability}
        print(json.dumps({**question, "answers": [answer._asdict() for answer in answers]}))
    else:
        rows = [(answer.question, str(answer.draws), answer.statement) for answer in answers]
        show_table(("question", "draws", "what one may say then"), rows)
    return DONE
