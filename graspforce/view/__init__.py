"""Pictures of problems, grasps, solutions and plans."""

from graspforce.view.plan_plots import plot_plan
from graspforce.view.show import show
from graspforce.view.solution_plots import plot_solution

__all__ = ["plot_plan", "plot_solution", "show"]
