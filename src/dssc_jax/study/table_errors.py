"""What is wrong with a study's table, in one line: path, rule, value, and the nearest valid name."""

from collections.abc import Collection, Iterable

from pydantic import ValidationError

from dssc_jax.core.errors import ConfigError, close_names, nearest
from dssc_jax.study.tables import quotes_hint

UNKNOWN_NAME = "unknown name"
NOT_SET = (
    "is not set by a study: the part computes it. A number of a part of your own that studies set has a type such as "
    'Annotated[float, Quantity("V", "source voltage")]'
)


def first_error(error: ValidationError, names: Iterable[str], computed: Collection[str] = ()) -> ConfigError:
    """The first error of pydantic as an error of this package; a misspelt name goes before all others.

    A name is misspelt if it is unknown and resembles one that is required and missing.

    Args:
        error: What pydantic found in the table.
        names: The valid names of the table.
        computed: Names of what its part computes, which a table must not set.
    """
    errors = error.errors()
    missing_names = [str(problem["loc"][-1]) for problem in errors if problem["type"] == "missing"]
    unknown_errors = [problem for problem in errors if problem["type"] == "extra_forbidden"]
    misspelt_errors = [problem for problem in unknown_errors if close_names(str(problem["loc"][-1]), missing_names)]
    first_error = misspelt_errors[0] if misspelt_errors else errors[0]
    path_parts = [str(part) for part in first_error["loc"]]  # none of a rule on several entries of the study
    path = ".".join(path_parts)
    value = first_error.get("input")
    hint = quotes_hint(".".join(path_parts[:-1]), path_parts[-1], value) if path_parts else ""
    if hint:
        return ConfigError(path, f"has no valid value{hint}")
    match first_error["type"]:
        case "extra_forbidden" if path_parts[-1] in computed:
            return ConfigError(path, NOT_SET)
        case "extra_forbidden":
            return ConfigError(path, f"{UNKNOWN_NAME}; {nearest(path_parts[-1], names)}")
        case "missing":
            return ConfigError(path, "is required and missing")
        case "value_error":
            return ConfigError(path, str(first_error.get("ctx", {}).get("error")))
        case "list_type" if isinstance(value, dict):
            return ConfigError(path, f"is a list of tables: write [[{path}]] instead of [{path}]")
        case "literal_error":
            expected = str(first_error.get("ctx", {}).get("expected")).replace("'", "")
            return ConfigError(path, f"'{value}' is none of {expected}")
        case _:
            return ConfigError(path, f"{first_error['msg'][0].lower()}{first_error['msg'][1:]}, got {value!r}")
