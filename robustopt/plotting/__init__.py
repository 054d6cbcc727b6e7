"""Figures of plans, executions and learning runs.

Every figure is a `matplotlib.figure.Figure`. Nothing here uses pyplot or changes the user's matplotlib settings.
"""

from robustopt.plotting.figures import figures, write_execution_figures, write_figures, write_learning_figure
from robustopt.plotting.joints import joint_figures
from robustopt.plotting.learning import learning_figure
from robustopt.plotting.phase_plane import phase_plane
from robustopt.plotting.shares import shares_figure
from robustopt.plotting.style import house_style
from robustopt.plotting.utilisation import contacts_figure
from robustopt.plotting.velocity_limit import velocity_limits

__all__ = [
    "contacts_figure",
    "figures",
    "house_style",
    "joint_figures",
    "learning_figure",
    "phase_plane",
    "shares_figure",
    "velocity_limits",
    "write_execution_figures",
    "write_figures",
    "write_learning_figure",
]
