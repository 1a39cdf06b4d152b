"""Lanes as machine code for 64-bit ARM, whose vectors have 128 bits (NEON), run by qemu."""

import shutil
import subprocess
import time
from pathlib import Path

import llvmlite.binding as llvm
import numpy as np
import pytest

from dssc_jax.lanes.interface import ENTRY_POINT
from dssc_jax.lanes.lanes import CompiledLanes
from dssc_jax.lanes.llvm.machine import CODE_LEVEL

TOOLS = ("aarch64-linux-gnu-gcc", "qemu-aarch64")
TRIPLE = "aarch64-unknown-linux-gnu"
PROCESSOR = "cortex-a72"
MISSING = [tool for tool in TOOLS if shutil.which(tool) is None]
needs_arm = pytest.mark.skipif(
    bool(MISSING), reason=f"no {MISSING}, which pip does not have: apt-get install gcc-aarch64-linux-gnu qemu-user"
)
CALLER = f"""
#include <stdio.h>
#include <stdlib.h>

extern void {ENTRY_POINT}(void *const *inputs, void *const *outputs, long first, long last);

/* Arguments: the lanes, the number of inputs, and the bytes of each input and output. */
int main(int count, char **arguments)
{{
    long number = atol(arguments[1]);
    int inputs = atoi(arguments[2]);
    int columns = count - 3;
    void **column = malloc(sizeof(void *) * (columns + 1));
    for (int i = 0; i < columns; i++) {{
        size_t bytes = strtoul(arguments[3 + i], NULL, 10);
        column[i] = aligned_alloc(64, (bytes + 63) / 64 * 64);
        if (i < inputs && fread(column[i], 1, bytes, stdin) != bytes)
            return 1;
    }}
    {ENTRY_POINT}(column, column + inputs, 0, number);
    for (int i = inputs; i < columns; i++) {{
        size_t bytes = strtoul(arguments[3 + i], NULL, 10);
        if (fwrite(column[i], 1, bytes, stdout) != bytes)
            return 1;
    }}
    return 0;
}}
"""


def target_machine():
    """A description of the processor for LLVM."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    target = llvm.Target.from_triple(TRIPLE)
    return target.create_target_machine(cpu=PROCESSOR, opt=CODE_LEVEL, reloc="pic", codemodel="default")


class ArmLanes(CompiledLanes):
    """The program of a lane for ARM; arguments as of :class:`dssc_jax.lanes.lanes.CompiledLanes`, after the folder.

    Args:
        folder: An empty folder for the program.
    """

    def __init__(self, folder, lane, *arguments, **options):
        self.folder = Path(folder)
        super().__init__(lane, *arguments, **options)

    @property
    def assembly(self):
        """The machine code for a reader."""
        return target_machine().emit_assembly(self.module())

    def module(self):
        """The text as a module for ARM."""
        module = llvm.parse_assembly(self.traced.text)
        module.triple, module.data_layout = TRIPLE, str(target_machine().target_data)
        return module

    def _signature(self):
        signature = super()._signature()
        return signature._replace(code=f"arm-{signature.code}")

    def compiled(self):
        """An object file for ARM."""
        return target_machine().emit_object(self.module())

    def load(self, code):
        """The program that runs the object file."""
        (self.folder / "lanes.o").write_bytes(code)
        (self.folder / "caller.c").write_text(CALLER)
        build = [TOOLS[0], "-O1", "-static", "-o", "program", "caller.c", "lanes.o", "-lm"]
        subprocess.run(build, cwd=self.folder, check=True)
        return ArmCode(self.folder / "program")


class ArmCode:
    """A program for ARM whose input and output are columns of lanes.

    Args:
        program: The file.
    """

    def __init__(self, program):
        self.program = program

    def start(self, inputs, outputs, lanes, width, threads):
        """Run all lanes; see :class:`dssc_jax.lanes.interface.Loaded`."""
        sizes = [column.nbytes for column in (*inputs, *outputs)]
        command = [TOOLS[1], self.program, *map(str, [lanes, len(inputs), *sizes])]
        given = b"".join(column.tobytes() for column in inputs)
        written = subprocess.run(command, input=given, stdout=subprocess.PIPE, check=True).stdout
        start = 0
        for column in outputs:
            column[:] = np.frombuffer(written, column.dtype, len(column), start)
            start += column.nbytes
        return time.perf_counter
