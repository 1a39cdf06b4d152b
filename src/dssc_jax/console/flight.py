"""Show what was generated for a flight computer."""

from typing import Any

from dssc_jax.console.terminal import output, show_table


def show_code(summary: dict[str, Any]) -> None:
    """Print each channel's functions and cost, and how to check them."""
    rows = []
    for each in summary["channels"]:
        operations = each["operations"]
        slow = sum(operations.get(name, 0) for name in ("div", "sqrt", "rem"))
        rows.append(
            (
                f"{each['prefix']}_step",
                str(sum(operations.values())),
                str(slow),
                str(each["chain"]),
                str(each["state_bytes"]),
                str(each["parameter_bytes"]),
            )
        )
    show_table(("function", "operations", "quotients, roots", "longest chain", "state [bytes]", "parameters"), rows)
    console = output()
    console.print(summary["certificate"], soft_wrap=True, markup=False)
    console.print(
        f"wrote {summary['folder']}; make -C {summary['folder']} checks every bit", soft_wrap=True, markup=False
    )
