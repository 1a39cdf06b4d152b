"""Names that are safe in C and C++: no keywords, no macros, and no names that libraries declare or linkers know."""

import re
from collections.abc import Iterable

KEYWORDS = frozenset({
    "asm", "auto", "bool", "break", "case", "char", "const", "continue", "default", "do", "double", "else", "enum",
    "extern", "false", "float", "for", "fortran", "goto", "if", "inline", "int", "long", "register", "restrict",
    "return", "short", "signed", "sizeof", "static", "struct", "switch", "true", "typedef", "typeof", "union",
    "unsigned", "void", "volatile", "while"
})  # fmt: skip
"""Keywords of C, with those of common compilers."""

CPP_KEYWORDS = frozenset({
    "alignas", "alignof", "and", "and_eq", "bitand", "bitor", "catch", "char16_t", "char32_t", "char8_t", "class",
    "co_await", "co_return", "co_yield", "compl", "concept", "const_cast", "consteval", "constexpr", "constinit",
    "decltype", "delete", "dynamic_cast", "explicit", "export", "friend", "mutable", "namespace", "new", "noexcept",
    "not", "not_eq", "nullptr", "operator", "or", "or_eq", "private", "protected", "public", "reinterpret_cast",
    "requires", "static_assert", "static_cast", "template", "this", "thread_local", "throw", "try", "typeid",
    "typename", "using", "virtual", "wchar_t", "xor", "xor_eq"
})  # fmt: skip
"""Keywords of C++: a header may be included there."""

MACROS = frozenset({
    "assert", "complex", "errno", "fpclassify", "imaginary", "isfinite", "isgreater", "isgreaterequal", "isinf",
    "isless", "islessequal", "islessgreater", "isnan", "isnormal", "isunordered", "linux", "math_errhandling",
    "offsetof", "setjmp", "signbit", "stderr", "stdin", "stdout", "unix", "va_arg", "va_copy", "va_end", "va_start"
})  # fmt: skip
"""Macros in small letters, of C's library and of compilers."""

FUNCTIONS = frozenset({
    "abort", "abs", "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "atexit", "atof", "atoi", "bits_of",
    "bsearch", "calloc", "cbrt", "ceil", "clock", "copysign", "cos", "cosh", "div", "erf", "erfc", "exit", "exp",
    "exp2", "expm1", "fabs", "fabsf", "fclose", "fdim", "finite", "floor", "fma", "fmax", "fmin", "fmod", "fmodf",
    "fopen", "fprintf", "fread", "free", "frexp", "fwrite", "gamma", "getc", "getenv", "gets", "hypot", "ilogb",
    "index", "is_finite", "j0", "j1", "jn", "labs", "ldexp", "lgamma", "link", "log", "log10", "log1p", "log2",
    "logb", "lrint", "lround", "main", "malloc", "maximum", "memchr", "memcmp", "memcpy", "memmove", "memset",
    "minimum", "modf", "nan", "nearbyint", "nearest", "nextafter", "number_of", "pause", "pow", "printf", "puts",
    "qsort", "raise", "rand", "read", "realloc", "remainder", "remove", "remquo", "rename", "rint", "round",
    "round_down", "round_up", "scalbn", "select", "setenv", "signal", "sin", "sinh", "sleep", "sprintf", "sqrt",
    "sqrtf", "srand", "sscanf", "strcat", "strcmp", "strcpy", "strlen", "strtod", "system", "tan", "tanh", "tgamma",
    "time", "toward_zero", "trunc", "ungetc", "wait", "write", "y0", "y1", "yn"
})  # fmt: skip
"""Functions of the usual libraries and of the generated source; a variable of the same name would hide them."""

LINKED = re.compile(r"(pthread|posix|sem|obstack|va|atomic|mtx|cnd|tss|thrd|fmi2|std|dssc_jax)(_.*)?")
"""Names that functions of libraries have: a generated ``sem_init`` or ``pthread_mutex_init`` would replace them."""


def is_reserved(name: str) -> bool:
    """Whether a name may not be used at all, not even for a member of a structure.

    Keywords and known macros are reserved. So are names without small letters, which are left to macros, and names with
    a leading or double underscore, which are left to compilers.
    """
    is_keyword = name in KEYWORDS or name in CPP_KEYWORDS
    may_be_macro = name in MACROS or not re.search("[a-z]", name)
    is_of_compilers = name.startswith("_") or "__" in name
    return is_keyword or may_be_macro or is_of_compilers


def is_forbidden(name: str) -> bool:
    """Whether no variable or file may have a name: the name is reserved, or a library's function has it."""
    return is_reserved(name) or name in FUNCTIONS


def underscored(text: str) -> str:
    """Return a text whose characters are all valid in a name of C.

    One underscore replaces each run of other characters or underscores. The text has no underscore at its ends.
    """
    return re.sub(r"(\W|_)+", "_", text, flags=re.ASCII).strip("_")


def member_name(text: str) -> str:
    """Return a valid name for a member of a structure, as near to a text as possible; "value" if nothing is left."""
    name = underscored(text) or "value"
    if name[0].isdigit():
        name = f"value_{name}"
    return f"{name}_" if is_reserved(name) else name


def member_names(texts: Iterable[str]) -> list[str]:
    """Return a valid name for each text, all different; the second of equal names ends in _2, the third in _3."""
    names: list[str] = []
    for text in texts:
        base = member_name(text)
        name = base
        count = 2
        while name in names:
            name = f"{base.rstrip('_')}_{count}"
            count += 1
        names.append(name)
    return names


def prefix_name(text: str) -> str:
    """Return a valid prefix of the names of functions and types, in small letters, as near to a text as possible.

    A text that cannot be such a prefix, such as a digit or the name of a library's function, gets "study_" before it.
    """
    name = underscored(text).lower()
    if not name[:1].isalpha() or is_forbidden(name) or LINKED.fullmatch(name):
        name = f"study_{name}".rstrip("_")
    return name


def c_string(text: str) -> str:
    """Return a text as a string literal in C; characters that are not printable ASCII become question marks."""
    printable = re.sub(r"[^\x20-\x7e]", "?", text)
    escaped = printable.replace("\\", "\\\\").replace('"', '\\"')
    without_trigraphs = escaped.replace("??", "?\\?")  # C reads ??/ and eight others as one character
    return f'"{without_trigraphs}"'
