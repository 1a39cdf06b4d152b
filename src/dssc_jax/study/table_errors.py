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


def explain(error: ValidationError, names: Iterable[str], computed: Collection[str] = ()) -> ConfigError:
    """The first error of pydantic as an error of this package; a misspelt name goes before all others.

    A name is misspelt if it is unknown and resembles one that is required and missing.

    Args:
        error: What pydantic found in the table.
        names: The valid names of the table.
        computed: Names of what its part computes, which a table must not set.
    """
    errors = error.errors()
    missing = [str(problem["loc"][-1]) for problem in errors if problem["type"] == "missing"]
    unknown = [problem for problem in errors if problem["type"] == "extra_forbidden"]
    misspelt = [problem for problem in unknown if close_names(str(problem["loc"][-1]), missing)]
    first = misspelt[0] if misspelt else errors[0]
    places = [str(part) for part in first["loc"]]  # none of a rule on several entries of the study
    path = ".".join(places)
    value = first.get("input")
    hint = quotes_hint(".".join(places[:-1]), places[-1], value) if places else ""
    if hint:
        return ConfigError(path, f"has no valid value{hint}")
    match first["type"]:
        case "extra_forbidden" if places[-1] in computed:
            return ConfigError(path, NOT_SET)
        case "extra_forbidden":
            return ConfigError(path, f"{UNKNOWN_NAME}; {nearest(places[-1], names)}")
        case "missing":
            return ConfigError(path, "is required and missing")
        case "value_error":
            return ConfigError(path, str(first.get("ctx", {}).get("error")))
        case "list_type" if isinstance(value, dict):
            return ConfigError(path, f"is a list of tables: write [[{path}]] instead of [{path}]")
        case "literal_error":
            expected = str(first.get("ctx", {}).get("expected")).replace("'", "")
            return ConfigError(path, f"'{value}' is none of {expected}")
        case _:
            return ConfigError(path, f"{first['msg'][0].lower()}{first['msg'][1:]}, got {value!r}")
