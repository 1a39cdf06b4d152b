"""Options of the commands on a loop's robustness: margin, theory, compare, loop, worst-loop, region."""

from dataclasses import dataclass
from typing import Annotated, ClassVar

import typer

from dssc_jax.analyses.defaults import CANDIDATES, CELLS, HALVINGS, SIGMA
from dssc_jax.cli.declarations.types import DrawsOptions, OutputOptions, Prove, WalkOptions


@dataclass(frozen=True, kw_only=True)
class Margin(OutputOptions, DrawsOptions, WalkOptions):
    """Find every draw's critical value of one number.

    The walk starts at LO, where draws are expected to pass; HI may be the lower end. `spread` in the place of a name
    widens all laws together.

    Prints the median, the value up to which 95 % of all draws pass with 95 % confidence (Wilks), the share of draws
    without a critical value between the bounds, the share that passes again beyond a failure, and what Theorem 1 says.
    With --prove, it also tells how far the sampled loop is proved, for all plants of the laws, or all winds within the
    bounds, at once.
    """

    controllers: Annotated[
        str | None, typer.Option("--controllers", metavar="A,B,..", help="Margins of each of these controllers.")
    ] = None
    prove: Prove = False


@dataclass(frozen=True, kw_only=True)
class Theory(OutputOptions, DrawsOptions, WalkOptions):
    """Compare theory with simulation for one number.

    Prints how far Theorem 1 certifies the loop, the local margin of the linearised loop, what describing functions
    predict (over unmodelled.mu), and the simulated margin. They answer different questions; where one of them does not
    apply, the answer says why. With --prove, also how far the sampled loop is proved, for all plants of the laws, or
    all winds within the bounds, at once.
    """

    synonyms: ClassVar = ("pole", "poles", "eig", "rlocus", "root-locus")

    prove: Prove = False


@dataclass(frozen=True, kw_only=True)
class Compare(OutputOptions, DrawsOptions):
    """Compare controllers on the same draws and noise.

    Gains that the study does not give follow from DSSC's; --tune also tunes all on equal budgets.

    Prints failure probabilities, and for every pair the difference with its interval and an exact paired test. Tuning
    uses other draws than the comparison. Plants of several channels are not tuned.
    """

    controllers: Annotated[
        str,
        typer.Option(
            "--controllers", metavar="A,B,..", help="Kinds, names of [compare.NAME], or your own module:OBJECT."
        ),
    ]
    tune: Annotated[
        int | None,
        typer.Option("--tune", metavar="N", min=0, help=f"Candidates for each controller; 0: none [{CANDIDATES}]."),
    ] = None


@dataclass(frozen=True, kw_only=True)
class Loop(OutputOptions, DrawsOptions):
    """Gain, phase, delay and disk margins of the linearised loop, over all draws.

    The sampled loop is linearised as it is simulated, and broken at the command of each channel and at each
    measurement. Also prints peak sensitivities, crossover and bandwidth, each with its median and the limit that 95 %
    of all draws meet with 95 % confidence (Wilks); draws Bode, Nyquist and sensitivity fans. A vehicle hovers, or is
    linearised along its flight with --at. The study's [sweep] is ignored.
    """

    synonyms: ClassVar = ("bode", "nyquist", "allmargin", "sigma-plot")

    at: Annotated[
        str | None,
        typer.Option("--at", metavar="T1,T2,..", help="Linearise along the flight, at these times [the equilibrium]."),
    ] = None


@dataclass(frozen=True, kw_only=True)
class WorstLoop(OutputOptions, DrawsOptions):
    """Worst margins of the linearised loop over the box of the laws, found and bounded.

    Gain, phase, delay and disk margins, M_s and M_t: the worst drawn, the worst found, and what is bounded for all
    numbers between the ends of their laws, at all frequencies. Also the robust stability factor: how far the box may
    grow before a loop is unstable (1/mu). Prints the numbers of each worst case, and writes them as studies
    (witnesses/LOOP-MARGIN.toml, for `loop` and `run`). A study of several commands also gets the disk margin of all of
    them at once, unless --broken-at is given. The study's [sweep] is ignored.
    """

    synonyms: ClassVar = ("mu", "mussv", "wcgain", "wcdiskmargin", "robstab", "robgain", "diskmargin")

    broken_at: Annotated[
        list[str] | None,
        typer.Option(
            "--broken-at", metavar="NAME", help="Break point, as `loop` names it; repeatable [each channel's input]."
        ),
    ] = None
    sigma: Annotated[
        float, typer.Option("--sigma", metavar="K", help="Laws without ends are cut at K standard deviations.")
    ] = SIGMA
    cells: Annotated[
        int, typer.Option("--cells", metavar="N", min=1, help="Largest number of cells of box and frequencies.")
    ] = CELLS
    points: Annotated[
        int | None,
        typer.Option(
            "--points",
            metavar="N",
            min=1,
            help="Largest number of points of the box to linearise [as many as take 1,000,000 derivatives].",
        ),
    ] = None


@dataclass(frozen=True, kw_only=True)
class Region(OutputOptions, DrawsOptions):
    """Over two numbers, where do at least 95 % of all plants meet the requirements, with 95 % confidence?

    Follows the boundary of the region on a lattice, with the same draws at every point, instead of simulating it all.
    The confidence holds for all points together. The figure also has the points that Theorem 1 certifies. The study's
    [sweep] is ignored.
    """

    over: Annotated[
        list[str], typer.Option("--over", metavar="NAME=LO:HI[:log]", help="A number and its range; give two.")
    ]
    halvings: Annotated[int, typer.Option("--halvings", metavar="N", help="Halvings of the coarse cells.")] = HALVINGS
