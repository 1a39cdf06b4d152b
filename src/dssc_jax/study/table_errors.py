"""Errors of a study's table in one line: path, rule, value, and the nearest valid name."""

from collections.abc import Collection, Iterable, Iterator
from contextlib import contextmanager

from pydantic import ValidationError

from dssc_jax.core.errors import ConfigError, close_names, nearest
from dssc_jax.study.tables import quotes_hint

UNKNOWN_NAME = "unknown name"
NOT_SET = (
    "is not set by a study: the part computes it. A number of a part of your own that studies set has a type such as "
    'Annotated[float, Quantity("V", "source voltage")]'
)


@contextmanager
def value_errors_at(place: str) -> Iterator[None]:
    """Report a ``ValueError`` raised inside as a ``ConfigError`` at a place of the study.

    Raises:
        ConfigError: The error with the place; a ``ConfigError`` raised inside has its own and passes unchanged.
    """
    try:
        yield
    except ConfigError:
        raise
    except ValueError as error:
        raise ConfigError(place, str(error)) from None


def first_error(error: ValidationError, names: Iterable[str], computed: Collection[str] = ()) -> ConfigError:
    """Translate the first of pydantic's errors into an error of this package; a misspelt name precedes all others.

    A name counts as misspelt if it is unknown and resembles one that is required and missing.

    Args:
        error: Errors that pydantic found in the table.
        names: Valid names of the table.
        computed: Names of fields that the part computes, which a table must not set.
    """
    errors = error.errors()
    missing_names = [str(item["loc"][-1]) for item in errors if item["type"] == "missing"]
    unknown_errors = [item for item in errors if item["type"] == "extra_forbidden"]
    misspelt_errors = [item for item in unknown_errors if close_names(str(item["loc"][-1]), missing_names)]
    problem = misspelt_errors[0] if misspelt_errors else errors[0]
    path_parts = [str(part) for part in problem["loc"]]  # empty for a rule on several entries of the study
    path = ".".join(path_parts)
    value = problem.get("input")
    hint = quotes_hint(".".join(path_parts[:-1]), path_parts[-1], value) if path_parts else ""
    if hint:
        return ConfigError(path, f"has no valid value{hint}")
    match problem["type"]:
        case "extra_forbidden" if path_parts[-1] in computed:
            return ConfigError(path, NOT_SET)
        case "extra_forbidden":
            return ConfigError(path, f"{UNKNOWN_NAME}; {nearest(path_parts[-1], names)}")
        case "missing":
            return ConfigError(path, "is required and missing")
        case "value_error":
            return ConfigError(path, str(problem.get("ctx", {}).get("error")))
        case "list_type" if isinstance(value, dict):
            return ConfigError(path, f"is a list of tables: write [[{path}]] instead of [{path}]")
        case "literal_error":
            expected = str(problem.get("ctx", {}).get("expected")).replace("'", "")
            return ConfigError(path, f"'{value}' is none of {expected}")
        case _:
            return ConfigError(path, f"{problem['msg'][0].lower()}{problem['msg'][1:]}, got {value!r}")
