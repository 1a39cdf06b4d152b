"""Small FMUs for tests, written, compiled and zipped here: a mass with drag, sampled exactly, and a PID.

Their numbers are those of the package's own models, so each loop has a counterpart without an FMU. One text of C serves
FMI 2.0 and 3.0.
"""

import subprocess
import zipfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from xml.sax.saxutils import quoteattr

COMPILE = ("cc", "-std=c99", "-O2", "-ffp-contract=off", "-fPIC", "-shared")
PLATFORMS = {"2.0": "linux64", "3.0": "x86_64-linux"}


@dataclass(frozen=True)
class Variable:
    """A variable of an FMU; its value reference is its index."""

    name: str
    causality: str
    start: float | None = None
    unit: str = ""
    minimum: float | None = None
    kind: str = "Real"


@dataclass(frozen=True)
class Source:
    """An FMU to build.

    Args:
        name: Its model identifier.
        variables: Its variables.
        start: C that begins at t = 0; ``r`` are the values of the variables.
        step: C that makes a step of length ``h`` at ``t``; returns a status.
        state: C of the instance's further members.
        statics: C of variables that all instances share.
        version: Version of FMI.
        attributes: Attributes of co-simulation in the description.
        interface: The element of the interface.
        platform: Folder of its library; empty: that of this machine.
    """

    name: str
    variables: tuple[Variable, ...]
    start: str
    step: str
    state: str = ""
    statics: str = ""
    version: str = "2.0"
    attributes: str = 'canHandleVariableCommunicationStepSize="true"'
    interface: str = "CoSimulation"
    platform: str = ""


MASS = Source(
    "mass",
    (
        Variable("u", "input", 0.0, "N"),
        Variable("d", "input", 0.0, "N"),
        Variable("x", "output", unit="m"),
        Variable("v", "output", unit="m/s"),
        Variable("drag", "parameter", 1.0, "1/s", minimum=0.01),
        Variable("body.gain", "parameter", 1.0),
        Variable("x0", "parameter", 0.0, "m"),
        Variable("v0", "parameter", 0.0, "m/s"),
        Variable("power", "output"),
        Variable("fails_at", "parameter", 0.0, "s"),
    ),
    start="r[2] = r[6]; r[3] = r[7]; r[8] = r[0] * r[3]; return 0;",
    step="""
    const double w = r[5] * (r[0] + r[1]), e = exp(-r[4] * h), s = (1.0 - e) / r[4];
    if (r[9] > 0.0 && t + 0.5 * h > r[9]) return 3;
    r[2] = r[2] + s * r[3] + (h - s) / r[4] * w;
    r[3] = e * r[3] + s * w;
    r[8] = r[0] * r[3];
    return 0;""",
)

PID = Source(
    "pid",
    (
        Variable("y", "input", 0.0),
        Variable("r", "input", 0.0),
        Variable("command", "output"),
        Variable("k_p", "parameter", 1.0, minimum=0.0),
        Variable("k_i", "parameter", 0.0),
        Variable("k_d", "parameter", 0.0),
        Variable("filter", "parameter", 0.0),
        Variable("integral", "output"),
    ),
    state="double sum, slope, last; int begun;",
    start="c->sum = c->slope = 0.0; c->begun = 0; return 0;",
    step="""
    if (!c->begun) { c->last = -r[0]; c->begun = 1; }
    const double weighted = -r[0], error = r[1] - r[0];
    const double slope = (r[6] * c->slope + r[5] * (weighted - c->last)) / (r[6] + h);
    r[2] = r[3] * error + c->sum + slope;
    r[7] = c->sum;
    c->sum += h * r[4] * error; c->slope = slope; c->last = weighted;
    return 0;""",
)

COMMON = """
#include <math.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#define API __attribute__((visibility("default")))
STATICS
typedef struct { double r[COUNT]; STATE } instance;
static const double starts[COUNT] = {STARTS};
static int start(instance *c) { double *const r = c->r; (void)r; START }
static int step(instance *c, double t, double h) { double *const r = c->r; (void)t; STEP }
static void *created(void) {
    instance *c = calloc(1, sizeof *c);
    if (c) memcpy(c->r, starts, sizeof starts);
    return c;
}
static int set(instance *c, const unsigned *places, size_t count, const double *values) {
    for (size_t i = 0; i < count; i++) { if (places[i] >= COUNT) return 3; c->r[places[i]] = values[i]; }
    return 0;
}
static int get(instance *c, const unsigned *places, size_t count, double *values) {
    for (size_t i = 0; i < count; i++) { if (places[i] >= COUNT) return 3; values[i] = c->r[places[i]]; }
    return 0;
}
"""

CALLS = {
    "2.0": """
API const char *fmi2GetVersion(void) { return "2.0"; }
API const char *fmi2GetTypesPlatform(void) { return "default"; }
API void *fmi2Instantiate(const char *n, int k, const char *g, const char *p, const void *f, int v, int l)
{ return k == 1 ? created() : NULL; }
API void fmi2FreeInstance(void *c) { free(c); }
API int fmi2SetupExperiment(void *c, int d, double e, double t, int s, double o) { return 0; }
API int fmi2EnterInitializationMode(void *c) { return 0; }
API int fmi2ExitInitializationMode(void *c) { return start(c); }
API int fmi2Terminate(void *c) { return 0; }
API int fmi2Reset(void *c) { return 0; }
API int fmi2SetReal(void *c, const unsigned *p, size_t n, const double *v) { return set(c, p, n, v); }
API int fmi2GetReal(void *c, const unsigned *p, size_t n, double *v) { return get(c, p, n, v); }
API int fmi2DoStep(void *c, double t, double h, int n) { return step(c, t, h); }
""",
    "3.0": """
API const char *fmi3GetVersion(void) { return "3.0"; }
API void *fmi3InstantiateCoSimulation(const char *n, const char *g, const char *p, bool v, bool l, bool e, bool r,
    const unsigned *q, size_t m, void *i, void *s, void *u) { return created(); }
API void fmi3FreeInstance(void *c) { free(c); }
API int fmi3EnterInitializationMode(void *c, bool d, double e, double t, bool s, double o) { return 0; }
API int fmi3ExitInitializationMode(void *c) { return start(c); }
API int fmi3Terminate(void *c) { return 0; }
API int fmi3Reset(void *c) { return 0; }
API int fmi3SetFloat64(void *c, const unsigned *p, size_t n, const double *v, size_t m) { return set(c, p, n, v); }
API int fmi3GetFloat64(void *c, const unsigned *p, size_t n, double *v, size_t m) { return get(c, p, n, v); }
API int fmi3DoStep(void *c, double t, double h, bool n, bool *e, bool *q, bool *y, double *l)
{ *e = *q = *y = false; *l = t + h; return step(c, t, h); }
""",
}

UNUSED = {
    "2.0": "CancelStep DeSerializeFMUstate FreeFMUstate GetBoolean GetBooleanStatus GetDirectionalDerivative "
    "GetFMUstate GetInteger GetIntegerStatus GetRealOutputDerivatives GetRealStatus GetStatus GetString "
    "GetStringStatus SerializeFMUstate SerializedFMUstateSize SetBoolean SetDebugLogging SetFMUstate SetInteger "
    "SetRealInputDerivatives SetString",
    "3.0": "ActivateModelPartition CompletedIntegratorStep DeserializeFMUState EnterConfigurationMode "
    "EnterContinuousTimeMode EnterEventMode EnterStepMode EvaluateDiscreteStates ExitConfigurationMode FreeFMUState "
    "GetAdjointDerivative GetBinary GetBoolean GetClock GetContinuousStateDerivatives GetContinuousStates "
    "GetDirectionalDerivative GetEventIndicators GetFMUState GetFloat32 GetInt16 GetInt32 GetInt64 GetInt8 "
    "GetIntervalDecimal GetIntervalFraction GetNominalsOfContinuousStates GetNumberOfContinuousStates "
    "GetNumberOfEventIndicators GetNumberOfVariableDependencies GetOutputDerivatives GetShiftDecimal GetShiftFraction "
    "GetString GetUInt16 GetUInt32 GetUInt64 GetUInt8 GetVariableDependencies InstantiateModelExchange "
    "InstantiateScheduledExecution SerializeFMUState SerializedFMUStateSize SetBinary SetBoolean SetClock "
    "SetContinuousStates SetDebugLogging SetFMUState SetFloat32 SetInt16 SetInt32 SetInt64 SetInt8 SetIntervalDecimal "
    "SetIntervalFraction SetShiftDecimal SetShiftFraction SetString SetTime SetUInt16 SetUInt32 SetUInt64 SetUInt8 "
    "UpdateDiscreteStates",
}
"""Functions that every library must export, and that nobody calls here."""


def code(source: Source) -> str:
    """The text of an FMU in C."""
    text = COMMON + CALLS[source.version]
    prefix = f"fmi{source.version[0]}"
    text += "".join(f"API int {prefix}{name}(void) {{ return 3; }}\n" for name in UNUSED[source.version].split())
    starts = ", ".join(repr(variable.start or 0.0) for variable in source.variables)
    parts = {"STARTS": starts, "STATICS": source.statics, "START": source.start, "STATE": source.state}
    for name, part in {**parts, "STEP": source.step, "COUNT": str(len(source.variables))}.items():
        text = text.replace(name, part)
    return text


def description(source: Source) -> str:
    """modelDescription.xml of an FMU."""
    units = "".join(f"<Unit name={quoteattr(unit)}/>" for unit in sorted({v.unit for v in source.variables} - {""}))
    units = f"<UnitDefinitions>{units}</UnitDefinitions>" if units else ""
    head = f'modelName="{source.name}" fmiVersion="{source.version}"'
    interface = f'<{source.interface} modelIdentifier="{source.name}" {source.attributes}/>'
    rows, outputs = [], []
    for place, variable in enumerate(source.variables):
        variability = "tunable" if variable.causality == "parameter" else "continuous"
        inner = f" start='{variable.start!r}'" if variable.start is not None else ""
        inner += f" unit={quoteattr(variable.unit)}" if variable.unit else ""
        inner += f" min='{variable.minimum!r}'" if variable.minimum is not None else ""
        named = f"name={quoteattr(variable.name)} valueReference='{place}' causality='{variable.causality}'"
        if source.version == "2.0":
            discrete = variability if variable.kind == "Real" else variability.replace("continuous", "discrete")
            inner = inner if variable.kind == "Real" else (" start='0'" if variable.start is not None else "")
            rows.append(f"<ScalarVariable {named} variability='{discrete}'><{variable.kind}{inner}/></ScalarVariable>")
            outputs.append(f"<Unknown index='{place + 1}'/>" if variable.causality == "output" else "")
        else:
            rows.append(f"<Float64 {named} variability='{variability}'{inner}/>")
            outputs.append(f"<Output valueReference='{place}'/>" if variable.causality == "output" else "")
    token = "guid" if source.version == "2.0" else "instantiationToken"
    found = "".join(outputs)
    if source.version == "3.0":
        rows.append(
            f"<Float64 name='time' valueReference='{len(rows)}' causality='independent' variability='continuous'/>"
        )
    outputs_text = f"<Outputs>{found}</Outputs>" if source.version == "2.0" else found
    return (
        f'<?xml version="1.0" encoding="UTF-8"?><fmiModelDescription {head} {token}="{{1}}">{interface}'
        f"{units}<ModelVariables>{''.join(rows)}</ModelVariables>"
        f"<ModelStructure>{outputs_text}</ModelStructure></fmiModelDescription>"
    )


def built(place: Path, source: Source, text: Callable[[str], str] = str) -> Path:
    """The file of an FMU, built in a folder; ``text`` changes its description."""
    folder = place / f"{source.name}_{source.version}_source"
    folder.mkdir(exist_ok=True)
    (folder / "model.c").write_text(code(source))
    library = folder / f"{source.name}.so"
    subprocess.run([*COMPILE, "-o", str(library), str(folder / "model.c"), "-lm"], check=True)
    file = place / f"{source.name}.fmu"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("modelDescription.xml", text(description(source)))
        archive.write(library, f"binaries/{source.platform or PLATFORMS[source.version]}/{source.name}.so")
    return file


def renamed(source: Source, name: str, **changes: object) -> Source:
    """An FMU of another name, with changes."""
    return replace(source, name=name, **changes)
