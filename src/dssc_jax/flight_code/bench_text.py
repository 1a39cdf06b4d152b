"""What the bench needs to know of the controllers, and the Makefile of the folder."""

from collections.abc import Sequence
from importlib.resources import files

from dssc_jax.flight_code.controller import COMMAND, SampledController
from dssc_jax.flight_code.names import identifier, prefix
from dssc_jax.flight_code.recording import row_names
from dssc_jax.lanes.c_names import c_string
from dssc_jax.lanes.c_operations import c_type
from dssc_jax.study import Study

MAKEFILE = """# The bench replays recorded draws of the study through the controller and compares every bit.
STRICT := -std=c99 -O2 -Wall -Wextra -Wconversion -Werror -pedantic -ffp-contract=off
STRICTER := -std=c++11 -O2 -Wall -Wextra -Werror -pedantic -ffp-contract=off
FILES := {name}_controller.c bench.c
NEEDED := $(FILES) {name}_controller.h bench_channels.h
RECORDING ?= recorded.bin

.PHONY: check cpp clang arm64 armhf sanitized detected cycles stack clean

check: bench  ## the same bits on this processor
	./bench $(RECORDING)

cpp: bench-cpp  ## the controller compiled as C++, called from C
	./bench-cpp $(RECORDING)

clang: bench-clang  ## compiled by clang
	./bench-clang $(RECORDING)

arm64: bench-arm64  ## on 64-bit ARM, by qemu where it is no such processor
	$(QEMU_ARM64) ./bench-arm64 $(RECORDING)

armhf: bench-armhf  ## on 32-bit ARM with hard floating point
	$(QEMU_ARMHF) ./bench-armhf $(RECORDING)

sanitized: bench-sanitized  ## address and undefined-behaviour sanitizers, and a million hostile samples
	./bench-sanitized $(RECORDING)
	./bench-sanitized --hostile 1000000

detected: bench-fast bench-contracted  ## builds that change bits are found and named
	! ./bench-fast $(RECORDING)
	! ./bench-contracted $(RECORDING)

cycles: bench
	./bench --cycles 100000

stack: {name}_controller.c {name}_controller.h  ## bytes of stack of each function
	$(CC) $(STRICT) -fstack-usage -c {name}_controller.c -o stack.o && cat *.su

QEMU_ARM64 ?= qemu-aarch64 -L /usr/aarch64-linux-gnu
QEMU_ARMHF ?= qemu-arm -L /usr/arm-linux-gnueabihf

bench: $(NEEDED)
	$(CC) $(STRICT) $(FILES) -o $@ -lm

bench-cpp: $(NEEDED)
	$(CXX) $(STRICTER) -x c++ -c {name}_controller.c -o controller-cpp.o
	$(CC) $(STRICT) bench.c controller-cpp.o -o $@ -lm

bench-clang: $(NEEDED)
	clang $(STRICT) $(FILES) -o $@ -lm

bench-arm64: $(NEEDED)
	aarch64-linux-gnu-gcc $(STRICT) $(FILES) -o $@ -lm

bench-armhf: $(NEEDED)
	arm-linux-gnueabihf-gcc $(STRICT) $(FILES) -o $@ -lm

bench-sanitized: $(NEEDED)
	$(CC) $(STRICT) -g -fsanitize=address,undefined -fno-sanitize-recover=all $(FILES) -o $@ -lm

bench-fast: $(NEEDED)
	$(CC) $(STRICT) -ffast-math -DDSSC_JAX_ANY_ARITHMETIC $(FILES) -o $@ -lm

bench-contracted: $(NEEDED)
	$(CC) $(STRICT) -ffp-contract=fast -march=native -DDSSC_JAX_ANY_ARITHMETIC $(FILES) -o $@ -lm

clean:
	rm -f bench bench-cpp bench-clang bench-arm64 bench-armhf bench-sanitized bench-fast bench-contracted *.o *.su
"""

CHANNEL = """
static {name}_controller controller_of_{name};

static void prepare_{name}(const real *given)
{{
    {name}_init(&controller_of_{name});
    if (given != NULL) {{
{set_parameters}
    }}
}}

static unsigned advance_{name}(const real *row, real *results, bool telemetry)
{{
    const {name}_measurement measurement = {{row[0], row[1]}};
    const {name}_reference reference = {{row[2], row[3], row[4]}};
    {name}_command command;
    {name}_telemetry seen = {{0}};
    {name}_controller *const controller = &controller_of_{name};
    const unsigned flag = {name}_step(controller, measurement, reference, &command, telemetry ? &seen : NULL);
{get_results}
    return flag;
}}
"""


def bench_source() -> str:
    """The source of the bench."""
    return (files("dssc_jax.flight_code") / "bench.c").read_text(encoding="utf-8")


def makefile(study: Study) -> str:
    """The Makefile of the folder."""
    return MAKEFILE.replace("{name}", identifier(study.name))


def channels_text(study: Study, controllers: Sequence[SampledController]) -> str:
    """``bench_channels.h``: the controllers as functions of arrays of numbers."""
    single = controllers[0].precision == 32
    letters = "FLT" if single else "DBL"
    lines = [
        "/* The controllers for the bench, as functions of arrays of numbers. */",
        f'#include "{identifier(study.name)}_controller.h"',
        "",
        f"typedef {c_type(controllers[0].real)} real;",
        f"typedef uint{controllers[0].precision}_t bits;",
        *(f"#define {word} {letters}_{name}" for word, name in
          (("EPSILON", "EPSILON"), ("SMALLEST", "MIN"), ("LARGEST", "MAX"))),
        f"#define CHANNELS {len(controllers)}u",
        f"#define MOST_PARAMETERS {max(1, *(len(each.parameters) for each in controllers), 1)}",
        f"#define MOST_RESULTS {max(len(row_names(each)) for each in controllers)}",
    ]  # fmt: skip
    return "\n".join([*lines, *(channel_text(study, each) for each in controllers), tables_text(study, controllers)])


def channel_text(study: Study, controller: SampledController) -> str:
    """The functions of one channel."""
    name = prefix(study, controller)
    variable = f"controller_of_{name}"
    given = [f"        {variable}.parameters.{each.name} = given[{i}];" for i, each in enumerate(controller.parameters)]
    results = [
        *(f"command.{member}" for member in COMMAND),
        *(f"{variable}.state.{state}" for state in controller.states),
    ]
    lines = [f"    results[{i}] = {member};" for i, member in enumerate(results)]
    if controller.infos:
        lines.append("    if (telemetry) {")
        lines += [f"        results[{len(results) + i}] = seen.{info};" for i, info in enumerate(controller.infos)]
        lines.append("    }")
    return CHANNEL.format(name=name, set_parameters="\n".join(given), get_results="\n".join(lines))


def tables_text(study: Study, controllers: Sequence[SampledController]) -> str:
    """The names of parameters and results, and the choice of a channel's functions."""
    lines, shapes = [], []
    for each in controllers:
        name = prefix(study, each)
        results = row_names(each)
        for kind, words in (("results", results), ("numbers", [p.name for p in each.parameters] or [""])):
            quoted = ", ".join(c_string(word) for word in words)
            lines.append(f"static const char *const {kind}_of_{name}[] = {{{quoted}}};")
        label = c_string(f"{each.channel}: " if each.channel else "")
        counts = f"{len(each.parameters)}u, {len(each.states)}u, {len(results)}u"
        shapes.append(f"    {{{label}, {counts}, results_of_{name}, numbers_of_{name}}},")
    names = [prefix(study, each) for each in controllers]
    cases = {
        f"static void {use}": [f"    case {i}:\n        {call.format(name=name)}" for i, name in enumerate(names)]
        for use, call in (
            ("prepare(unsigned channel, const real *given)", "prepare_{name}(given);\n        break;"),
            ("restart(unsigned channel)", "{name}_reset(&controller_of_{name});\n        break;"),
        )
    }
    checks = []
    for i, name in enumerate(names):
        checks.append(f"    case {i}:\n        return {name}_check(&controller_of_{name}.parameters);")
    advance = [
        f"    case {i}:\n        return advance_{name}(row, results, telemetry);" for i, name in enumerate(names)
    ]
    lines += ["", "static const channel_shape shapes[] = {", *shapes, "};"]
    for head, body in cases.items():
        lines += ["", head, "{", "    switch (channel) {", *body, "    default:\n        break;", "    }", "}"]
    check = "static unsigned check(unsigned channel)"
    lines += ["", check, "{", "    switch (channel) {", *checks, "    default:\n        return 0;", "    }", "}"]
    signature = "static unsigned advance(unsigned channel, const real *row, real *results, bool telemetry)"
    lines += ["", signature, "{", "    switch (channel) {", *advance, "    default:\n        return 0;", "    }", "}"]
    return "\n".join([*lines, ""])
