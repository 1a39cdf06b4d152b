"""Study files and results folders as accident and malice make them; each kind is a function of a random generator."""

import copy
import json
import shutil
import tomllib
from collections.abc import Callable
from pathlib import Path
from random import Random
from typing import Any

STUDIES = sorted((Path(__file__).parents[1] / "studies").glob("*.toml"))
ABSURD = (0, -1, 1e308, -1e308, 5e-324, 10**30, 2**31, float("nan"), float("inf"), 1e-30, "", "x" * 5000, True, [], {})
OTHERS = ("text", 3, 0.5, False, [1, 2], [[1]], {"a": 1}, {"kind": "x"}, {"uniform": [0, 1]}, {"uniform": [1, 0]})
OTHERS += (
    {"uniform": "x"},
    [{}],
    "os:system",
    "builtins:eval",
    "..:x",
    "a b:c",
    "antigravity:x",
    "__main__:x",
    {"kind": 3},
)
HUGE = 10 * 2**20  # bytes


def toml(value: Any) -> str:
    """A value as TOML, tables inline."""
    if isinstance(value, dict):
        return "{ " + ", ".join(f"{json.dumps(k)} = {toml(v)}" for k, v in value.items()) + " }"
    if isinstance(value, list):
        return "[" + ", ".join(map(toml, value)) + "]"
    if isinstance(value, float):
        return repr(value)
    return json.dumps(value)


def document(table: dict[str, Any]) -> bytes:
    """A whole file."""
    return "".join(f"{json.dumps(name)} = {toml(value)}\n" for name, value in table.items()).encode()


def places(table: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The path of every value in a table."""
    found = [path] if path else []
    inner = table.items() if isinstance(table, dict) else enumerate(table) if isinstance(table, list) else ()
    for key, value in inner:
        found += places(value, (*path, key))
    return found


def changed(random: Random, change: Callable[[Any, Any], None]) -> bytes:
    """A study with one place changed: ``change`` gets the container and the key."""
    table = tomllib.loads(random.choice(STUDIES).read_text())
    table = copy.deepcopy(table)
    path = random.choice(places(table))
    here = table
    for key in path[:-1]:
        here = here[key]
    change(here, path[-1])
    return document(table)


def letters(random: Random) -> bytes:
    """One to three characters replaced, deleted or put in."""
    text = list(random.choice(STUDIES).read_text())
    for _ in range(random.randint(1, 3)):
        i = random.randrange(len(text))
        text[i : i + random.randint(0, 1)] = random.choice("abz019.,=[]{}\"'#_- \n\t\0\x1bé\u202e")
    return "".join(text).encode()


def misspelt(random: Random) -> bytes:
    """One name changed."""

    def rename(here: Any, key: Any) -> None:
        if isinstance(here, dict):
            name = str(key)
            i = random.randrange(len(name))
            here[name[:i] + random.choice(["", "x", ".", " ", "\n"]) + name[i + 1 :]] = here.pop(key)

    return changed(random, rename)


def retyped(random: Random) -> bytes:
    """One value of another type."""
    return changed(random, lambda here, key: here.__setitem__(key, random.choice(OTHERS)))


def absurd(random: Random) -> bytes:
    """One value out of this world."""
    return changed(random, lambda here, key: here.__setitem__(key, random.choice(ABSURD)))


def deleted(random: Random) -> bytes:
    """One key or item less."""
    return changed(random, lambda here, key: here.__delitem__(key))


def encoded(random: Random) -> bytes:
    """Another encoding, or bytes that are none."""
    text = random.choice(STUDIES).read_text().replace("\n", "  # é\n", 1)
    whole = text.encode()
    cut = random.randrange(len(whole))
    noise = bytes(random.randrange(256) for _ in range(8))
    kinds = [text.encode("utf-16"), text.encode("utf-32"), text.encode("latin-1"), b"\xef\xbb\xbf" + whole]
    return random.choice([*kinds, whole[:cut], whole[:cut] + noise + whole[cut:], noise * 500, b"", whole * 2])


def enormous(random: Random) -> bytes:
    """Ten megabytes of nesting, of names or of nothing; and the same in small."""
    size = random.choice([2**10, 2**16, 2**19, HUGE])
    return random.choice(
        [
            b"a = " + b"[" * size,
            b"a = " + b"[" * size + b"]" * size,
            b"a = " + b"{a=" * (size // 3),
            b"a" + b".a" * (size // 2) + b" = 1",
            b"[" + b"a." * (size // 2) + b"a]",
            b"[[a]]\n" * (size // 6),
            b"#" * size,
            b"\n" * size,
            b'name = "' + b"n" * size + b'"',
            b"seed = " + b"9" * size,
            b"draws = " + toml(list(range(size // 8))).encode(),
            random.choice(STUDIES).read_bytes() + b"\n[" + b"plant.x" * 20 + b"]\nx = " + b"[" * 90 + b"]" * 90,
        ]
    )


STUDY_KINDS = (letters, misspelt, retyped, absurd, deleted, encoded, enormous)


def damage(random: Random, folder: Path) -> str:
    """Harm a results folder in one way; what was done."""
    return random.choice((content_harmed, metadata_altered, exchanged, misplaced))(random, folder)


def parts(folder: Path, kind: str = "") -> list[Path]:
    """The files that a result is read from; those of a kind: ``zarr.json``, ``c`` for chunks, ``digests``."""
    files = sorted(file for file in folder.rglob("*") if file.is_file() and "figures" not in file.parts)
    wanted = {kind} if kind else {"zarr.json", "manifest.json", "c", "digests"}
    return [file for file in files if wanted & {*file.relative_to(folder).parts}]


def content_harmed(random: Random, folder: Path) -> str:
    """A file cut, emptied, replaced by noise or a folder, or one of its values changed; or an array less."""
    file = folder / "manifest.json" if random.random() < 0.3 else random.choice(parts(folder))
    where = file.relative_to(folder)
    content = file.read_bytes()
    kind = random.choice(["deleted", "cut", "emptied", "flipped", "noise", "folder", "value", "array"])
    if kind == "deleted":
        file.unlink()
    elif kind == "cut":
        file.write_bytes(content[: random.randrange(len(content))])
    elif kind == "emptied":
        file.write_bytes(b"")
    elif kind == "flipped":
        i = random.randrange(len(content))
        file.write_bytes(content[:i] + bytes([content[i] ^ (1 << random.randrange(8))]) + content[i + 1 :])
    elif kind == "noise":
        file.write_bytes(bytes(random.randrange(256) for _ in range(len(content))))
    elif kind == "folder":
        file.unlink()
        file.mkdir()
    elif kind == "array":
        shutil.rmtree(folder / "data.zarr" / random.choice(["outcome", "error_rms", "draw", "plant.k_p"]))
    elif file.suffix == ".json":
        return f"{where}: {changed_value(random, file)}"
    else:
        file.write_bytes(content * 2)
    return f"{where}: {kind}"


def changed_value(random: Random, file: Path) -> str:
    """One value of a JSON file changed, taken away, or put in."""
    table = json.loads(file.read_text())
    path = random.choice(places(table))
    here = table
    for key in path[:-1]:
        here = here[key]
    how = random.choice(["changed", "taken away", "put in"])
    if how == "taken away":
        del here[path[-1]]
    elif how == "put in" and isinstance(here, dict):
        here["stopping"] = {"rule": "r", "most": 9, "verdict": "narrow", "stops": 3, "looks": []}
    else:
        here[path[-1]] = random.choice([*ABSURD[:6], *OTHERS, None, [10**12], "../../x"])
    file.write_text(json.dumps(table))
    return f"{'.'.join(map(str, path))} {how}"


def metadata_altered(random: Random, folder: Path) -> str:
    """What Zarr says of an array, altered to something that it reads without complaint."""
    file = random.choice([file for file in parts(folder, "zarr.json") if file.parent.name != "data.zarr"])
    table = json.loads(file.read_text())
    kind = random.choice(("endian", "fill_value", "codec", "dimension_names", "units", "long_name"))
    if kind == "endian":
        table["codecs"][0]["configuration"]["endian"] = "big"
    elif kind == "fill_value":
        table["fill_value"] = 0
    elif kind == "codec":
        table["codecs"][1]["configuration"]["checksum"] = False
    elif kind == "dimension_names":
        table["dimension_names"] = [f"other_{name}" for name in table["dimension_names"]]
    else:
        table["attributes"][kind] = "km"
    file.write_text(json.dumps(table))
    return f"{file.relative_to(folder)}: {kind}"


def exchanged(random: Random, folder: Path) -> str:
    """Two files that each change places with the other: chunks, digests, or metadata."""
    kind = random.choice(("c", "c", "digests", "zarr.json"))
    one, other = random.sample(parts(folder, kind), 2)
    first, second = one.read_bytes(), other.read_bytes()
    one.write_bytes(second)
    other.write_bytes(first)
    return f"{one.relative_to(folder)} and {other.relative_to(folder)} exchanged"


def misplaced(random: Random, folder: Path) -> str:
    """A file copied over another of its kind."""
    one, other = random.sample(parts(folder, random.choice(("c", "c", "digests"))), 2)
    shutil.copy(one, other)
    return f"{one.relative_to(folder)} copied over {other.relative_to(folder)}"
