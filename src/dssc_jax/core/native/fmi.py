"""Functional mock-up units (FMU): the calls of co-simulation in FMI 2.0 and 3.0.

FMPy reads an FMU, unpacks it and loads its library. The calls of a step go from here directly to that library, with
arrays that stay in place, because such a call is made for each sample of each draw.

References:
    Functional Mock-up Interface Specification, versions 2.0.4 (sections 2.1 and 4.2) and 3.0.1 (section 4).
"""

import ctypes
from abc import ABC, abstractmethod
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any, NamedTuple

from dssc_jax.core.errors import ConfigError

if TYPE_CHECKING:
    from fmpy.model_description import ModelDescription

WARNING = 1
"""The highest status of a successful call: 0 is ok, 1 is a warning."""

ADDRESS = ctypes.c_void_p
SIZE = ctypes.c_size_t
REAL = ctypes.c_double
FLAG = ctypes.c_int  # fmi2Boolean
TRUTH = ctypes.c_bool  # fmi3Boolean

StatusCall = Callable[..., int]
"""A function of the FMU that returns its status."""


class Fmpy(NamedTuple):
    """The modules of FMPy: the package itself, and its calls of FMI 2.0 and 3.0."""

    package: ModuleType
    fmi2: ModuleType
    fmi3: ModuleType


def fmpy() -> Fmpy:
    """Import the modules of FMPy, which is an optional dependency.

    Raises:
        ConfigError: FMPy is not installed.
    """
    try:
        import fmpy as package
        from fmpy import fmi2, fmi3
    except ImportError as error:
        raise ConfigError("file", "an FMU needs FMPy: pip install 'dssc_jax[fmu]'") from error
    return Fmpy(package, fmi2, fmi3)


class FmiCalls(ABC):
    """The calls of one FMU's library, for any number of instances.

    An instance is identified by the address that the library returns. ``set_reals`` and ``get_reals`` take an instance,
    value references, their number and an array of float64, and return a status.
    """

    set_reals: StatusCall
    get_reals: StatusCall
    last_message: str = ""
    "The last message of the FMU; empty before the first."

    def note(self, *message: object) -> None:
        """Keep the text of a message that the FMU logs.

        Args:
            message: All arguments of the FMU's call of its logger, of which the last one is the text.
        """
        text = message[-1]
        self.last_message = text.decode("utf-8", "replace") if isinstance(text, bytes) else ""

    @abstractmethod
    def instantiate(self, name: str) -> int:
        """Make a new instance, and return its address.

        Raises:
            FmiError: The library makes no instance.
        """

    @abstractmethod
    def initialise(self, instance: int) -> None:
        """Start an instance at t = 0, after its parameters were set.

        Raises:
            FmiError: A call fails.
        """

    @abstractmethod
    def step(self, instance: int, t: float, h: float) -> bool:
        """Make the step from t to t + h [s]; return whether the step succeeded and the instance may continue."""

    @abstractmethod
    def free(self, instance: int) -> None:
        """Free an instance."""


class FmiError(Exception):
    """A call of an FMU has failed."""


def require_success(function: str, status: int) -> None:
    """Require that a call of an FMU has succeeded.

    Args:
        function: Name of the function that was called, for the message.
        status: The status that the function returned.

    Raises:
        FmiError: The status is above :data:`WARNING`.
    """
    if status > WARNING:
        raise FmiError(f"{function} fails with status {status}")


def status_function(library: ctypes.CDLL, name: str, *types: type) -> StatusCall:
    """Return a function of an FMU's library that returns a status, in a form that Python can call.

    Args:
        library: The library.
        name: Name of the function.
        types: Types of the function's arguments in C.
    """
    return ctypes.CFUNCTYPE(ctypes.c_int, *types)((name, library))


def slave_of(kind: Callable[..., Any], folder: Path, description: "ModelDescription") -> Any:
    """Load the library of an unpacked FMU by FMPy's class for its version of FMI, and return the object of the class.

    Args:
        kind: FMPy's class, ``FMU2Slave`` or ``FMU3Slave``.
        folder: The unpacked FMU.
        description: The description of the FMU, which has co-simulation.
    """
    identifier = description.coSimulation.modelIdentifier  # type: ignore[union-attr]
    return kind(guid=description.guid or "", unzipDirectory=str(folder), modelIdentifier=identifier)


class Fmi2Calls(FmiCalls):
    """Co-simulation in FMI 2.0.

    Args:
        folder: The unpacked FMU.
        description: Its description, which has co-simulation.
    """

    def __init__(self, folder: Path, description: "ModelDescription") -> None:
        """Load the library and find its functions; callbacks are kept, because the library holds their addresses."""
        modules = fmpy()
        self._slave = slave_of(modules.fmi2.FMU2Slave, folder, description)
        functions = self._slave.dll
        self._guid = (description.guid or "").encode()
        self._resources = (folder / "resources").as_uri().encode()
        self._logger = modules.fmi2.fmi2CallbackLoggerTYPE(self.note)
        self._callbacks = modules.fmi2.fmi2CallbackFunctions()
        self._callbacks.logger = self._logger
        self._callbacks.allocateMemory = modules.fmi2.defaultCallbacks.allocateMemory
        self._callbacks.freeMemory = modules.fmi2.defaultCallbacks.freeMemory
        self.set_reals = status_function(functions, "fmi2SetReal", ADDRESS, ADDRESS, SIZE, ADDRESS)
        self.get_reals = status_function(functions, "fmi2GetReal", ADDRESS, ADDRESS, SIZE, ADDRESS)
        self._set_up = status_function(functions, "fmi2SetupExperiment", ADDRESS, FLAG, REAL, REAL, FLAG, REAL)
        self._enter = status_function(functions, "fmi2EnterInitializationMode", ADDRESS)
        self._exit = status_function(functions, "fmi2ExitInitializationMode", ADDRESS)
        self._step = status_function(functions, "fmi2DoStep", ADDRESS, REAL, REAL, FLAG)

    def instantiate(self, name: str) -> int:
        """Make a new instance, and return its address; raise FmiError if the library makes none."""
        co_simulation = 1
        visible = 0
        logging = 0
        callbacks = ctypes.byref(self._callbacks)
        instance = self._slave.fmi2Instantiate(
            name.encode(), co_simulation, self._guid, self._resources, callbacks, visible, logging
        )
        if not instance:
            raise FmiError("fmi2Instantiate gives no instance")
        return instance

    def initialise(self, instance: int) -> None:
        """Start an instance at t = 0, without a tolerance and without an end time; raise FmiError if a call fails."""
        # each flag 0 tells that the number behind it is not defined
        tolerance = 0, 0.0
        stop = 0, 0.0
        start_time = 0.0
        require_success("fmi2SetupExperiment", self._set_up(instance, *tolerance, start_time, *stop))
        require_success("fmi2EnterInitializationMode", self._enter(instance))
        require_success("fmi2ExitInitializationMode", self._exit(instance))

    def step(self, instance: int, t: float, h: float) -> bool:
        """Make the step from t to t + h [s]; return whether the step succeeded."""
        is_final_at_t = 1  # no earlier state will be asked for
        return self._step(instance, t, h, is_final_at_t) <= WARNING

    def free(self, instance: int) -> None:
        """Free an instance, which may be in any state."""
        self._slave.fmi2FreeInstance(instance)


class Fmi3Calls(FmiCalls):
    """Co-simulation in FMI 3.0, without events, early return and intermediate updates.

    Args:
        folder: The unpacked FMU.
        description: Its description, which has co-simulation.
    """

    def __init__(self, folder: Path, description: "ModelDescription") -> None:
        """Load the library and find its functions; callbacks are kept, because the library holds their addresses."""
        modules = fmpy()
        self._slave = slave_of(modules.fmi3.FMU3Slave, folder, description)
        functions = self._slave.dll
        self._instantiation_token = (description.guid or "").encode()  # guid is FMPy's name of the instantiation token
        self._resources = f"{folder / 'resources'}/".encode()
        self._logger = modules.fmi3.fmi3LogMessageCallback(self.note)
        self._intermediate_update = modules.fmi3.fmi3IntermediateUpdateCallback()
        self._no_references = (modules.fmi3.fmi3ValueReference * 0)()
        self._environment = modules.fmi3.fmi3InstanceEnvironment()
        set_reals = status_function(functions, "fmi3SetFloat64", ADDRESS, ADDRESS, SIZE, ADDRESS, SIZE)
        get_reals = status_function(functions, "fmi3GetFloat64", ADDRESS, ADDRESS, SIZE, ADDRESS, SIZE)
        self.set_reals = lambda instance, places, count, values: set_reals(instance, places, count, values, count)
        self.get_reals = lambda instance, places, count, values: get_reals(instance, places, count, values, count)
        self._enter = status_function(functions, "fmi3EnterInitializationMode", ADDRESS, TRUTH, REAL, REAL, TRUTH, REAL)
        self._exit = status_function(functions, "fmi3ExitInitializationMode", ADDRESS)
        outcome_types = [ADDRESS] * 4  # event, end, early return, reached time
        self._step = status_function(functions, "fmi3DoStep", ADDRESS, REAL, REAL, TRUTH, *outcome_types)

    def instantiate(self, name: str) -> int:
        """Make a new instance, and return its address; raise FmiError if the library makes none."""
        options = (False, False, False, False)  # visible, logging, event mode, early return
        instance = self._slave.fmi3InstantiateCoSimulation(
            name.encode(),
            self._instantiation_token,
            self._resources,
            *options,
            self._no_references,
            len(self._no_references),
            self._environment,
            self._logger,
            self._intermediate_update,
        )
        if not instance:
            raise FmiError("fmi3InstantiateCoSimulation gives no instance")
        return instance

    def initialise(self, instance: int) -> None:
        """Start an instance at t = 0, without a tolerance and without an end time; raise FmiError if a call fails."""
        # each flag False tells that the number behind it is not defined
        tolerance = False, 0.0
        stop = False, 0.0
        start_time = 0.0
        require_success("fmi3EnterInitializationMode", self._enter(instance, *tolerance, start_time, *stop))
        require_success("fmi3ExitInitializationMode", self._exit(instance))

    def step(self, instance: int, t: float, h: float) -> bool:
        """Make the step from t to t + h [s]; return whether the step succeeded and the instance asks for no end."""
        has_event = TRUTH(False)
        is_ended = TRUTH(False)
        is_early = TRUTH(False)
        reached_time = REAL(t + h)
        outcome_addresses = (
            ctypes.addressof(has_event),
            ctypes.addressof(is_ended),
            ctypes.addressof(is_early),
            ctypes.addressof(reached_time),
        )
        is_final_at_t = True  # no earlier state will be asked for
        status = self._step(instance, t, h, is_final_at_t, *outcome_addresses)
        return status <= WARNING and not is_ended.value

    def free(self, instance: int) -> None:
        """Free an instance, which may be in any state."""
        self._slave.fmi3FreeInstance(instance)


VERSIONS: dict[str, Callable[[Path, "ModelDescription"], FmiCalls]] = {"2.0": Fmi2Calls, "3.0": Fmi3Calls}
"""The calls of each version of FMI that can be run; of 3.0.1 too, whose number begins with 3.0."""
