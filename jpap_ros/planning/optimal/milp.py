"""A thin layer over HiGHS: linear and mixed-integer programs over 0/1 columns, with start, time limit and bound."""

from __future__ import annotations

import math
import time
from dataclasses import dataclass

import highspy
import numpy as np
from scipy import sparse

from jpap_ros.planning.link_budget import Floats


@dataclass(frozen=True, eq=False)
class Result:
    """What HiGHS found.

    Attributes
    ----------
    x : (n,) float or None
        The best feasible point, None where none was found.
    objective : float
        Its value; infinite where there is none.
    bound : float
        Proven lower bound on the objective; infinite where the problem is infeasible.
    duals : (m,) float or None
        Of the rows; of a linear program only.
    """

    x: Floats | None
    objective: float
    bound: float
    duals: Floats | None = None


def minimise(
    cost: Floats,
    matrix: sparse.csc_array,
    row_lower: Floats,
    row_upper: Floats,
    *,
    integer: bool,
    start: Floats | None = None,
    deadline: float = math.inf,
    gap: float = 1e-9,
) -> Result:
    """Minimise cost x with row_lower <= matrix x <= row_upper and x >= 0; x is 0 or 1 if integer.

    Parameters
    ----------
    integer : bool
        Whether x must be 0 or 1. A linear program has no upper bounds: where its rows imply x <= 1, as those of
        covers and partitions do, bounds would only take part of the rows' duals.
    start : (n,) array, optional
        A feasible point to begin from.
    deadline : float
        `time.monotonic()` by which to return.
    gap : float
        Absolute gap between objective and bound at which to stop.
    """
    solver = highspy.Highs()  # type: ignore[no-untyped-call]
    for option, value in (
        ("output_flag", False),
        ("threads", 1),
        ("mip_rel_gap", 0.0),
        ("mip_abs_gap", gap),
        ("time_limit", max(deadline - time.monotonic(), 0.0) if math.isfinite(deadline) else math.inf),
    ):
        solver.setOptionValue(option, value)
    rows, columns = matrix.shape
    model = highspy.HighsLp()
    model.num_col_, model.num_row_ = columns, rows
    model.col_cost_ = cost
    model.col_lower_, model.col_upper_ = np.zeros(columns), np.full(columns, 1.0 if integer else np.inf)
    model.row_lower_, model.row_upper_ = row_lower, row_upper
    model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
    model.a_matrix_.start_ = matrix.indptr
    model.a_matrix_.index_ = matrix.indices
    model.a_matrix_.value_ = matrix.data
    if integer:
        model.integrality_ = [highspy.HighsVarType.kInteger] * columns
    solver.passModel(model)
    if start is not None:
        point = highspy.HighsSolution()
        point.col_value = list(start)
        point.value_valid = True
        solver.setSolution(point)
    solver.run()
    return _result(solver, integer)


def _result(solver: highspy.Highs, integer: bool) -> Result:
    status, info = solver.getModelStatus(), solver.getInfo()
    if status == highspy.HighsModelStatus.kInfeasible:
        return Result(None, math.inf, math.inf)
    feasible = info.primal_solution_status == highspy.SolutionStatus.kSolutionStatusFeasible
    solution = solver.getSolution()
    x = np.array(solution.col_value) if feasible else None
    objective = info.objective_function_value if feasible else math.inf
    if integer:
        return Result(x, objective, info.mip_dual_bound)
    solved = status == highspy.HighsModelStatus.kOptimal
    return Result(x, objective, objective if solved else -math.inf, np.array(solution.row_dual) if solved else None)


def incidence(sets: list[np.ndarray], devices: int) -> sparse.csc_array:
    """The 0/1 matrix with a row for each device and a column for each set."""
    sizes = np.fromiter((len(members) for members in sets), dtype=np.int64, count=len(sets))
    indices = np.concatenate(sets) if sets else np.empty(0, np.int64)
    return sparse.csc_array(
        (np.ones(len(indices)), indices.astype(np.int32), np.concatenate([[0], np.cumsum(sizes)]).astype(np.int32)),
        shape=(devices, len(sets)),
    )
