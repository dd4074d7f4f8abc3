"""Pictures of problems, grasps, solutions and plans."""

from graspforce.core.optional_libraries import optional_imports

with optional_imports("matplotlib"):
    from graspforce.view.analysis_plots import (
        plot_contact_regions,
        plot_limits,
        plot_payload,
        plot_sensitivities,
        plot_wrench_set,
    )
    from graspforce.view.plan_plots import plot_plan
    from graspforce.view.show import show
    from graspforce.view.solution_plots import plot_solution

__all__ = [
    "plot_contact_regions",
    "plot_limits",
    "plot_payload",
    "plot_plan",
    "plot_sensitivities",
    "plot_solution",
    "plot_wrench_set",
    "show",
]
