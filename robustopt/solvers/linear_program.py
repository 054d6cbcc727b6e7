"""Small dense linear programs that HiGHS solves repeatedly, with a new right-hand side each time."""

from __future__ import annotations

import highspy
import numpy as np

from robustopt.arrays import Array


class _Silent(highspy.Highs):  # type: ignore[misc]
    """HiGHS without output: since version 1.16 it prints its name and licence while it starts its callbacks."""

    def enableCallbacks(self) -> None:  # noqa: N802
        """Silence the output, then start the callbacks."""
        self.setOptionValue("output_flag", False)
        super().enableCallbacks()


class LinearProgram:
    """The program min cost z such that row_lower <= matrix z <= row_upper and lower <= z.

    Each call of `solve` brings its own row bounds, and starts from the last basis.
    """

    def __init__(self, matrix: Array, cost: Array, lower: Array) -> None:
        """Make a program.

        Args:
            matrix: coefficients of the rows (m, n).
            cost: coefficients of the cost (n,).
            lower: lower bounds of z (n,).
        """
        rows, columns = matrix.shape
        model = highspy.HighsLp()
        model.num_col_, model.num_row_ = columns, rows
        model.col_cost_, model.col_lower_, model.col_upper_ = cost, lower, np.full(columns, np.inf)
        model.row_lower_ = model.row_upper_ = np.zeros(rows)
        model.a_matrix_.format_ = highspy.MatrixFormat.kColwise
        model.a_matrix_.start_ = rows * np.arange(columns + 1)
        model.a_matrix_.index_ = np.tile(np.arange(rows), columns)
        model.a_matrix_.value_ = matrix.T.ravel()
        self._highs = _Silent()
        for option, value in (("output_flag", False), ("presolve", "off"), ("threads", 1)):
            self._highs.setOptionValue(option, value)
        self._highs.passModel(model)
        self._rows = np.arange(rows, dtype=np.int32)

    def solve(self, row_lower: Array, row_upper: Array) -> tuple[Array, Array]:
        """Return the solution z (n,) and the duals of all rows, added rows last.

        Args:
            row_lower: lower bounds of the first rows (m,).
            row_upper: upper bounds of the first rows (m,).
        """
        self._highs.changeRowsBounds(len(self._rows), self._rows, row_lower, row_upper)
        self._highs.run()
        solution = self._highs.getSolution()
        return np.array(solution.col_value), np.array(solution.row_dual)
