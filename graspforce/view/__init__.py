"""Pictures of problems, grasps, solutions and plans."""

from graspforce.view.show import show
from graspforce.view.solution_plots import plot_solution

__all__ = ["plot_solution", "show"]
