"""The header of a study's controllers in C99 and C++, and the README of their folder."""

from collections.abc import Iterable

from dssc_jax.core.signals import ReferencePoint
from dssc_jax.flight_code.c_files import comment_lines, generated_by, header_file
from dssc_jax.flight_code.controller import COMMAND, FlightCode, SampledController
from dssc_jax.flight_code.parameters import parameter_comment
from dssc_jax.flight_code.template_files import fill
from dssc_jax.study import Study

LARGEST_ANGLE = 1e5
"""Size of an angle beyond which a reading is refused [rad]; in float32 its resolution is 0.008 rad there."""
ANGLE_NOTE = f"""
 * Angles may have many turns: the measurement, in (-pi, pi] or not, is made continuous, and the error is
 * wrapped. One beyond {LARGEST_ANGLE:g} rad counts as not finite."""


def header_text(code: FlightCode) -> str:
    """The header file with the structures and functions of all channels."""
    channels = "\n".join(declarations(code.study, controller) for controller in code.controllers)
    return header_file(f"{code.name}_controller", file_comment(code), channels)


def file_comment(code: FlightCode) -> list[str]:
    """The lines of the first comment of header and source: study, sample time, certificate, and missing parts."""
    sentences = [
        f"Controller of the study {code.study.name}. {generated_by('dssc-jax code')}",
        f"Study: {code.study.hash}",
        f"Sample time: {code.study.loop.sample_time:g} s, a constant of the code. {code.precision} bits a number.",
        code.certificate,
        "Equation numbers are those of the article Dynamic Smooth Sliding Control Applied to UAV Trajectory Tracking.",
        "Compile without contraction and without fast arithmetic: cc -std=c99 -O2 -ffp-contract=off.",
        f"Not generated: {'; '.join(missing_parts(code.study))}.",
    ]
    return comment_lines(sentences)


def missing_parts(study: Study) -> list[str]:
    """The parts of the loop that a flight needs beside the generated code, in words.

    The plant's software on board is among them unless it is generated, too, which needs a period of its own.
    """
    software = study.loop.plant.software
    generated = software is not None and software.period(study.template.plant) is not None
    return [
        *(() if generated else study.loop.plant.onboard),
        "sensors with their filters and the estimator of the measurement",
        "the reference",
        "actuators, and limits of the command that the controller does not have",
    ]


def declarations(study: Study, controller: SampledController) -> str:
    """The declarations in C of the structures and functions of one channel.

    Args:
        study: The study.
        controller: The controller of the channel.
    """
    units = study.units[controller.index]
    command = units.command
    reference_units = (units.output, f"{units.output}/s", f"{units.output}/s^2")
    command_comments = (f"{command}, robust", f"{command}, nominal", f"{command}, u + u_n (11)")
    parameter_comments = {}
    for number, parameter in enumerate(controller.parameters, start=1):
        parameter_comments[parameter.name] = parameter_comment(number, parameter)

    def members(comments: dict[str, str]) -> list[str]:
        """The members of a structure of numbers, each with its comment; C has no empty structures."""
        comments = comments or {"unused": "there is none"}
        return [member_text(controller.c_real, name, explanation) for name, explanation in comments.items()]

    return fill(
        "channel.h",
        name=controller.prefix,
        parameters=members(parameter_comments),
        measurement=members({signal.name: signal.unit for signal in controller.measured_signals}),
        reference=members(dict(zip(ReferencePoint._fields, reference_units, strict=True))),
        command=members(dict(zip(COMMAND, command_comments, strict=True))),
        state=members(dict.fromkeys(controller.states, "")),
        telemetry=members(dict.fromkeys(controller.infos, "")),
        angle=ANGLE_NOTE if is_angle(study, controller) else "",
        transfer=transfer_declaration(controller),
    )


def member_text(kind: str, name: str, explanation: str) -> str:
    """The declaration in C of a member of a structure, with an explanation as its comment.

    Marks in the explanation that would end the comment are broken up; characters beyond ASCII become ?.

    Args:
        kind: Type in C.
        name: Name of the member.
        explanation: Text of the comment; empty: no comment.
    """
    if not explanation:
        return f"{kind} {name};"
    plain = explanation.replace("*/", "* /").replace("/*", "/ *").encode("ascii", "replace").decode()
    return f"{kind} {name};  /* {plain} */"


def is_angle(study: Study, controller: SampledController) -> bool:
    """Whether the output of the channel is an angle.

    Args:
        study: The study, whose plant names the channels of angles.
        controller: The controller of the channel.
    """
    return controller.channel in study.loop.plant.angles


def transfer_declaration(controller: SampledController) -> str:
    """The declaration in C of the function for a bumpless start, or a comment why there is none.

    Args:
        controller: The controller of the channel.
    """
    if controller.transfer is None:
        return f"/* No {controller.prefix}_transfer: the controller has no state that could carry a command. */"
    return fill(
        "transfer.h",
        name=controller.prefix,
        real=controller.c_real,
        smallest=f"{controller.smallest_difference:g}",
    )


def readme_text(code: FlightCode, further_sections: Iterable[str]) -> str:
    """``README.md`` of the folder of generated code.

    Args:
        code: The controllers.
        further_sections: Lines of the sections on software on board and on the monitor.
    """
    return fill(
        "README.md",
        name=code.name,
        study=code.study.name,
        first=code.controllers[0].prefix,
        sample_time=f"{code.study.loop.sample_time:g}",
        precision=str(code.precision),
        certificate=code.certificate,
        channels=[channel_item(code.study, controller) for controller in code.controllers],
        not_generated=[f"* {part}" for part in missing_parts(code.study)],
        monitor=further_sections,
    )


def channel_item(study: Study, controller: SampledController) -> str:
    """The item of a channel in the README's list."""
    name = controller.prefix
    channel = f"channel {controller.channel}" if controller.channel else "the only channel"
    angle = ", an angle: unwrapping and wrapping are generated" if is_angle(study, controller) else ""
    missing = "" if controller.transfer else f"; there is no `{name}_transfer`"
    return f"* `{name}_...`: differentiator and controller of {channel}{angle}{missing}."
