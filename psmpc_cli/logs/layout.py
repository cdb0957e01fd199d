"""The HDF5 layout of a log: every dataset with its dimensions, units and long name. Documented in docs/log.md."""

from dataclasses import dataclass

FORMAT_VERSION = 1
"""Changes when a reader of the old layout would misread the new one."""


RUN, COMPARISON, SWEEP, PARETO, MONTE_CARLO = "run", "comparison", "sweep", "pareto", "monte-carlo"
"""Attribute `kind`: the log of one run (also where it is missing), a file of several, and the results of studies."""


@dataclass(frozen=True)
class Column:
    """One dataset with a row a sample or a tick.

    Attributes:
        path: Where it stands.
        scale: Path of the dimension scale of its second dimension; empty for one value a row.
        units: SI units.
        long_name: What it is, for a plot's axis or a reader.
        dtype: NumPy type.
    """

    path: str
    scale: str
    units: str
    long_name: str
    dtype: str = "f8"


@dataclass(frozen=True)
class Table:
    """One dataset whose size is known before the run.

    Attributes:
        path: Where it stands.
        scales: Paths of the dimension scales of its dimensions.
        units: SI units.
        long_name: What it is.
        dtype: NumPy type, or `text`.
        unknown: What stands where there is no value (yet).
    """

    path: str
    scales: tuple[str, ...]
    units: str
    long_name: str
    dtype: str = "f8"
    unknown: float = float("nan")


@dataclass(frozen=True)
class Scale:
    """One dimension scale whose size is known before the run.

    Attributes:
        path: Where it stands; its last part is the name of the dimension.
        units: SI units.
        long_name: What it is.
    """

    path: str
    units: str
    long_name: str


Q_UNITS, V_UNITS, A_UNITS, F_UNITS = "m, rad", "m/s, rad/s", "m/s^2, rad/s^2", "N, N m"

SCALES = (
    Scale("coordinate", "1", "generalized coordinate"),
    Scale("pose_coordinate", "1", "pose coordinate"),
    Scale("stage", "1", "stage"),
    Scale("momentum", "1", "component of momentum"),
    Scale("stages/epsilon", A_UNITS, "threshold on a stage's presence that marks its actual start"),
    Scale("monitors/name", "1", "name of the monitor"),
)
"""What runs along every dimension but time."""

MOMENTUM = ("x", "y", "angular")
"""Components of the momentum: linear, and angular about the inertial origin."""

AXES = ("x", "y")
"""Axes of a body."""

TIME = Column("time", "", "s", "sample time")

DEVIATIONS = (
    Column("deviation/Q", "coordinate", Q_UNITS, "generalized coordinates at the next sample less the plan's"),
    Column("deviation/Qdot", "coordinate", V_UNITS, "generalized velocities at the next sample less the plan's"),
    Column("deviation/end", "stage", "1", "error of an end condition over its tolerance, where its stage hands over"),
)
"""How far the motion is from the plan in force; logs of an earlier version lack them."""

BASIN = (
    Column("window/basin", "", "1", "guess of the instants that won, 0 the last plan's; -1 if the only one", "i4"),
)
"""Which of several solves of a window stands; logs of an earlier version lack it."""

UNMEASURED = (
    Column("events/unmeasured", "", "1", "the measured state was not finite, and the plan's stood in for it", "i1"),
)
"""Where the state is not the one that the controller sees; logs of an earlier version lack it."""

NODES = (Column("window/nodes", "stage", "1", "intervals N_s of each stage; NaN outside the window"),)
"""The mesh of each window; logs of an earlier version lack it, and have the task's everywhere."""

WARM = (Column("solver/warm", "", "1", "the solve started from the last solution, shifted", "i1"),)
"""How each solve started; logs of an earlier version lack it, and it did where multipliers are logged."""

TRUE_STATE = (
    Column("state/Q_true", "coordinate", Q_UNITS, "generalized coordinates, true"),
    Column("state/Qdot_true", "coordinate", V_UNITS, "generalized velocities, true"),
)
"""Where measurements have noise, along /time."""

PAYLOAD = (
    Column("payload/held", "", "1", "whether the grippers hold the payload from the sample on", "i1"),
    Column("payload/energy", "", "J", "kinetic energy gained at the sample by taking it up or letting it go"),
)
"""Where the object has a mass, along /time."""

DISTURBANCE = (Column("control/disturbance", "coordinate", A_UNITS, "estimated disturbance, taken off the control"),)
"""Under offset-free control, along /time."""

COLUMNS = (
    Column("state/Q", "coordinate", Q_UNITS, "generalized coordinates, as the controller saw them"),
    Column("state/Qdot", "coordinate", V_UNITS, "generalized velocities, as the controller saw them"),
    Column("control/u", "coordinate", A_UNITS, "applied acceleration over the first tick"),
    Column("force/F", "coordinate", F_UNITS, "generalized force of the low-level controller at the sample"),
    Column("pose/xi", "pose_coordinate", Q_UNITS, "poses of base and end-effectors"),
    Column("window/first", "", "1", "index of the current stage", "i4"),
    Column("window/count", "", "1", "number of stages in the window", "i4"),
    Column("window/instants", "stage", "s", "optimized instant that ends each stage; NaN outside the window"),
    Column("window/cost", "stage", "1", "normalized cost integral of each stage; NaN outside the window"),
    *BASIN,
    *NODES,
    Column("window/presence", "stage", A_UNITS, "how much of a waiting stage is in the control; NaN if not looked at"),
    Column("window/share", "stage", "1", "share of each stage in the applied control; NaN where it has none"),
    Column("events/appended", "", "1", "a stage entered the window", "i1"),
    Column("events/postponed", "", "1", "a stage was seen, but the window with it had no solution yet", "i1"),
    Column("events/fallback", "", "1", "the solve failed and the shifted plan went on", "i1"),
    Column("events/braking", "", "1", "the plan was used up and the robot braked to rest", "i1"),
    *UNMEASURED,
    Column("solver/status", "", "1", "outcome of the solve", "S16"),
    *WARM,
    Column("solver/iterations", "", "1", "iterations of the solve", "i4"),
    Column("solver/wall_time", "", "s", "wall time of the solve alone"),
    Column("solver/objective", "", "1", "objective J"),
    Column("normalization/nadir", "stage", "1", "divisor of each window stage's cost; NaN outside the window"),
    Column("cost/current_stage", "", "1", "cost Lbar of the current stage"),
    Column("margin/position", "coordinate", Q_UNITS, "smallest distance to a position limit until the next sample"),
    Column("margin/velocity", "coordinate", V_UNITS, "smallest distance to a velocity limit until the next sample"),
    Column("effort/control", "", "m^2/s^3, rad^2/s^3", "integral of |u|^2 until the next sample"),
    Column("effort/base_force", "", "N s", "integral of the norm of the base force until the next sample"),
    Column("effort/base_torque", "", "N m s", "integral of the magnitude of the base torque until the next sample"),
    *DEVIATIONS,
    Column("balance/momentum", "momentum", "N s, N m s", "momentum less the integral of the external wrench"),
    Column("balance/energy", "", "J", "kinetic energy less the work of the generalized forces"),
)
"""Every dataset with one row a sample, along /time."""

LEVELS = (
    Column("levels/objective", "stage", "1", "optimum of the cost each level minimizes; NaN where none converged"),
    Column("levels/cost", "stage", "1", "cost of each level's stage at the last level that converged"),
    Column("levels/wall_time", "stage", "s", "wall time of each level's solve alone; NaN where there was none"),
    Column("levels/solved", "stage", "1", "1 if the level converged, 0 if not, -1 where there was none", "i1"),
)
"""Every dataset with one row a sample of a lexicographic controller's levels, along /time."""

OPTIONAL = (LEVELS, TRUE_STATE, PAYLOAD, DISTURBANCE)
"""Datasets along /time that only some logs have, each group as a whole."""

TICK = Column("ticks/tick", "", "1", "number of the tick, from 0", "i8")

TICKS = (
    Column("ticks/time", "", "s", "tick time"),
    Column("ticks/Q", "coordinate", Q_UNITS, "generalized coordinates at every tick"),
    Column("ticks/Qdot", "coordinate", V_UNITS, "generalized velocities at every tick"),
    Column("ticks/F", "coordinate", F_UNITS, "generalized force held from the tick on"),
)
"""Every dataset with one row a low-level tick, along /ticks/tick."""

TABLES = (
    Table("stages/name", ("stage",), "1", "name of the stage", "text"),
    Table("stages/priority", ("stage",), "1", "priority omega of the stage"),
    Table("stages/switch_time", ("stage",), "s", "instant that ends the stage; NaN if it never ended"),
    Table("stages/actual_start", ("stage",), "s", "first sample at which the stage acts on the control; NaN if never"),
    Table("stages/premature", ("stage",), "1", "whether it acts before the stage before it has ended", "i1", 0),
    Table("stages/actual_start_by_epsilon", ("stage", "stages/epsilon"), "s", "actual start for each threshold"),
    # not `time`: netCDF readers would take it for the dimension of that name
    Table("final/end_time", (), "s", "end of the run; NaN if it was stopped before"),
    Table("final/Q", ("coordinate",), Q_UNITS, "generalized coordinates at the end of the run"),
    Table("final/Qdot", ("coordinate",), V_UNITS, "generalized velocities at the end of the run"),
    Table("final/xi", ("pose_coordinate",), Q_UNITS, "poses of base and end-effectors at the end of the run"),
    Table("monitors/held", ("monitors/name",), "1", "1 if the monitor held, 0 if not, -1 if not known", "i1", -1),
    Table("monitors/margin", ("monitors/name",), "m, m/s", "smallest distance of the signal to its bounds"),
)
"""Every dataset that does not grow."""

FINAL_TRUE = (
    Table("final/Q_true", ("coordinate",), Q_UNITS, "generalized coordinates at the end of the run, true"),
    Table("final/Qdot_true", ("coordinate",), V_UNITS, "generalized velocities at the end of the run, true"),
)
"""Where measurements have noise."""

DRAWN_SCALES = (
    Scale("uncertainty/body", "1", "body"),
    Scale("uncertainty/axis", "1", "axis of the body"),
)
"""What runs along the dimensions of the drawn numbers."""

DRAWN = (
    Table("uncertainty/mass_factor", ("uncertainty/body",), "1", "true mass over the described one"),
    Table("uncertainty/inertia_factor", ("uncertainty/body",), "1", "true inertia over the described one"),
    Table(
        "uncertainty/centre_of_mass",
        ("uncertainty/body", "uncertainty/axis"),
        "m",
        "offset of the true centre of mass from the described one",
    ),
)
"""Where a task has an uncertainty, what was drawn for it."""

PLANS = (
    ("plan/guess", "primal point each solve started from"),
    ("plan/guess_multipliers", "multipliers of bounds and rows each solve started from; empty where it took none"),
    ("plan/parameters", "parameter vector of each window's NLP"),
    ("plan/solution", "primal solution of each solve"),
)
"""Vectors whose length changes from sample to sample: a row a sample, NaN behind its <path>_length elements."""
