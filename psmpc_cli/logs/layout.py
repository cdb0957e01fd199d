"""The HDF5 layout of a log: every dataset with its shape, units and long name. Documented in docs/log.md."""

from dataclasses import dataclass

FORMAT_VERSION = 1
"""Changes when a reader of the old layout would misread the new one."""


@dataclass(frozen=True)
class Column:
    """One dataset with a row a sample.

    Attributes:
        path: Where it stands.
        scale: Name of the dimension scale of its second dimension; empty for one value a sample.
        units: SI units.
        long_name: What it is, for a plot's axis or a reader.
        dtype: NumPy type.
    """

    path: str
    scale: str
    units: str
    long_name: str
    dtype: str = "f8"


Q_UNITS, V_UNITS, A_UNITS, F_UNITS = "m, rad", "m/s, rad/s", "m/s^2, rad/s^2", "N, N m"

COLUMNS = (
    Column("state/Q", "coordinate", Q_UNITS, "generalized coordinates, measured"),
    Column("state/Qdot", "coordinate", V_UNITS, "generalized velocities, measured"),
    Column("control/u", "coordinate", A_UNITS, "applied acceleration over the first tick"),
    Column("force/F", "coordinate", F_UNITS, "generalized force of the low-level controller at the sample"),
    Column("pose/xi", "pose_coordinate", Q_UNITS, "poses of base and end-effectors"),
    Column("window/first", "", "1", "index of the current stage", "i4"),
    Column("window/count", "", "1", "number of stages in the window", "i4"),
    Column("window/instants", "stage", "s", "optimized instant that ends each stage; NaN outside the window"),
    Column("window/presence", "stage", A_UNITS, "norm of the control a waiting stage adds; NaN where not looked at"),
    Column("events/appended", "", "1", "a stage entered the window", "i1"),
    Column("events/postponed", "", "1", "a stage was seen, but the window with it had no solution yet", "i1"),
    Column("events/fallback", "", "1", "the solve failed and the shifted plan went on", "i1"),
    Column("events/braking", "", "1", "the plan was used up and the robot braked to rest", "i1"),
    Column("solver/status", "", "", "outcome of the solve", "S16"),
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
    Column("balance/momentum", "momentum", "N s, N m s", "momentum less the integral of the external wrench"),
    Column("balance/energy", "", "J", "kinetic energy less the work of the generalized forces"),
)
"""Every dataset with one row a sample, along /time."""

TICKS = (
    Column("ticks/Q", "coordinate", Q_UNITS, "generalized coordinates at every tick"),
    Column("ticks/Qdot", "coordinate", V_UNITS, "generalized velocities at every tick"),
    Column("ticks/F", "coordinate", F_UNITS, "generalized force held from the tick on"),
)
"""Every dataset with one row a low-level tick, along /ticks/time."""

PLANS = (
    ("plan/guess", "primal point each solve started from"),
    ("plan/guess_multipliers", "multipliers of bounds and rows each solve started from; empty where it took none"),
    ("plan/parameters", "parameter vector of each window's NLP"),
    ("plan/solution", "primal solution of each solve"),
)
"""Vectors whose length changes from sample to sample: flat, with the offset of each sample in <path>_offset."""
