"""Compiling what was generated, where there are compilers."""

import ctypes
import shutil
import subprocess
from typing import NamedTuple

import pytest

FLAGS = ["-std=c99", "-O2", "-Wall", "-Wextra", "-Wconversion", "-Werror", "-pedantic", "-ffp-contract=off"]


def require(*programs):
    """Skip the test where a program is missing."""
    missing = [program for program in programs if shutil.which(program) is None]
    if missing:
        pytest.skip(f"needs {', '.join(missing)}")


def made(folder, *targets, fails=False):
    """What `make` prints in a folder."""
    done = subprocess.run(["make", *targets], cwd=folder, capture_output=True, text=True, check=False)
    assert (done.returncode != 0) == fails, done.stdout + done.stderr
    return done.stdout + done.stderr


class Answer(NamedTuple):
    """What a step gives: the flag, the command (u, u_n, u_p), the state after it, and the telemetry."""

    flag: int
    command: tuple
    state: tuple
    telemetry: tuple


class CompiledController:
    """A generated controller of one channel, compiled as a library and called from Python.

    Args:
        folder: A ``FlightFolder``.
        place: Where to compile it.
        index: Position of the channel.
    """

    def __init__(self, folder, place, index=0):
        require("cc")
        for name, text in folder.texts().items():
            (place / name).write_text(text)
        self.controller = folder.code.controllers[index]
        self.name = self.controller.prefix
        library = place / f"{self.name}.so"
        source = place / f"{folder.code.name}_controller.c"
        subprocess.run(["cc", *FLAGS, "-fPIC", "-shared", str(source), "-o", str(library), "-lm"], check=True)
        self.library = ctypes.CDLL(str(library))
        number = ctypes.c_float if self.controller.precision == 32 else ctypes.c_double
        self.number = number

        def structure(members):
            fields = [(member, number) for member in members or ("unused",)]
            return type("Structure", (ctypes.Structure,), {"_fields_": fields})

        self.parameters_type = structure([parameter.name for parameter in self.controller.parameters])
        self.state_type = structure(self.controller.states)
        self.command_type = structure(("u", "u_n", "u_p"))
        self.telemetry_type = structure(self.controller.infos)
        self.measurement_type = structure(("y", "y_dot"))
        self.reference_type = structure(("y", "y_dot", "y_ddot"))
        fields = [
            ("parameters", self.parameters_type),
            ("state", self.state_type),
            ("last", self.command_type),
            ("started", ctypes.c_bool),
        ]
        self.memory = type("Controller", (ctypes.Structure,), {"_fields_": fields})()
        self.function("init")(ctypes.byref(self.memory))

    def function(self, name):
        """One of the generated functions."""
        found = getattr(self.library, f"{self.name}_{name}")
        found.restype = ctypes.c_uint
        return found

    def state(self):
        """The numbers of the state."""
        return tuple(getattr(self.memory.state, name) for name in self.controller.states)

    def reset(self):
        self.function("reset")(ctypes.byref(self.memory))

    def check(self):
        """What ``check`` says of the present parameters."""
        return self.function("check")(ctypes.byref(self.memory.parameters))

    def step(self, measurement, reference):
        """One sample."""
        command, telemetry = self.command_type(), self.telemetry_type()
        flag = self.function("step")(
            ctypes.byref(self.memory),
            self.measurement_type(*measurement),
            self.reference_type(*reference),
            ctypes.byref(command),
            ctypes.byref(telemetry),
        )
        seen = tuple(getattr(telemetry, name) for name in self.controller.infos)
        return Answer(flag, (command.u, command.u_n, command.u_p), self.state(), seen)

    def transfer(self, measurement, reference, command):
        """A state that carries a command; the flag."""
        return self.function("transfer")(
            ctypes.byref(self.memory),
            self.measurement_type(*measurement),
            self.reference_type(*reference),
            self.number(command),
        )
