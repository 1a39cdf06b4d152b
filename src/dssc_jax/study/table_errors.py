"""Errors of a study's table in one line: path, rule, value, and the nearest valid name."""

from collections.abc import Collection, Iterable, Iterator, Mapping
from contextlib import contextmanager

from pydantic import ValidationError

from dssc_jax.core.errors import ConfigError, close_names, nearest
from dssc_jax.study.parsed_values import AXES
from dssc_jax.study.tables import KEYED_BY_NAMES, toml_entry

UNKNOWN_NAME = "unknown name"
"""Beginning of the rule in the error about an unknown name."""
NOT_SET = (
    "is not set by a study: the part computes it. A number of a part of your own that studies set has a type such as "
    'Annotated[float, Quantity("V", "source voltage")]'
)
"""Rule in the error about a field that a table must not set."""


@contextmanager
def value_errors_at(place: str) -> Iterator[None]:
    """Turn a ``ValueError`` within the context into a ``ConfigError`` at a place of the study.

    Raises:
        ConfigError: The error with the place. A ``ConfigError`` within the context already has a place, and passes
            unchanged.
    """
    try:
        yield
    except ConfigError:
        raise
    except ValueError as error:
        raise ConfigError(place, str(error)) from None


def first_error(error: ValidationError, names: Iterable[str], computed: Collection[str] = ()) -> ConfigError:
    """Translate pydantic's first error into an error of this package; an error about a misspelt name comes first.

    A name counts as misspelt if it is unknown and resembles a required name that is missing.

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
            message = problem["msg"]
            return ConfigError(path, f"{message[0].lower()}{message[1:]}, got {value!r}")


def quotes_hint(section: str, key: str, value: object) -> str:
    """Hint for a name with dots that was not quoted, so that TOML read it as tables.

    Args:
        section: Dotted name of the table.
        key: Key whose value is not valid.
        value: Value of the key.

    Returns:
        End of a message with the quoted entry; empty if there is no hint.
    """
    if section not in KEYED_BY_NAMES or section == "correlation":  # whose keys are pairs of names
        return ""
    parts = [key]
    while isinstance(value, Mapping) and len(value) == 1:
        inner_key = str(next(iter(value)))
        if close_names(inner_key, AXES):  # a spacing, perhaps misspelt
            break
        parts.append(inner_key)
        value = value[inner_key]
    is_name_without_dot = len(parts) == 1
    is_other_table = isinstance(value, Mapping) and not value.keys() <= set(AXES)
    if is_name_without_dot or is_other_table:
        return ""
    return f"; a name with a dot needs quotes: {toml_entry('.'.join(parts), value)}"
