"""The C library as a package: built, installed and used by C and C++ programs through CMake and pkg-config."""

from __future__ import annotations

import os
import shutil
import subprocess
from pathlib import Path

import pytest

import graspforce

SOURCES = Path(graspforce.get_cmake_dir()).parent
HAS_COMPILERS = all(any(map(shutil.which, names)) for names in (("cc", "gcc", "clang"), ("c++", "g++", "clang++")))
pytestmark = pytest.mark.skipif(not (shutil.which("cmake") and HAS_COMPILERS), reason="needs CMake, a C and a C++ compiler")

LISTS = """
cmake_minimum_required(VERSION 3.17)
project(consumer LANGUAGES C CXX)
find_package(graspforce {version} REQUIRED)
add_executable(from_c main.c)
set_target_properties(from_c PROPERTIES C_STANDARD 11)
target_link_libraries(from_c PRIVATE graspforce::graspforce)
add_executable(from_cpp main.cpp)
set_target_properties(from_cpp PROPERTIES CXX_STANDARD 17)
target_link_libraries(from_cpp PRIVATE graspforce::graspforce)
"""

# One frictionless contact carries 2 N. The C++ program also certifies its solution and calls the control step.
C_PROGRAM = """
#include <graspforce/slip_step.h>
#include <graspforce/solve.h>
#include <graspforce/version.h>
#include <stdio.h>
#include <stdlib.h>
int main(void)
{
    const int components[1] = {1}, contact_block[1] = {0};
    const double G[6] = {0, 0, 1, 0, 0, 0}, w[6] = {0, 0, 2, 0, 0, 0}, zero[1] = {0}, limit[1] = {10};
    gf_structure hand = {.contacts = 1, .blocks = 1, .components = components, .contact_block = contact_block};
    gf_problem problem = {
        .G = G, .w = w, .mu = zero, .gamma = zero, .min_normal = zero, .max_normal = limit, .force_weight = 1};
    double f[1], y[6], z[1], nu_lower[1], nu_upper[1];
    gf_solution solution = {.f = f, .y = y, .z = z, .nu_lower = nu_lower, .nu_upper = nu_upper};
    gf_options options = GF_OPTIONS_DEFAULT;
    void *workspace = malloc(gf_workspace_size(&hand));
    gf_status status = gf_solve(&hand, &problem, &options, workspace, &solution);
    printf("%s %s %.6f\\n", gf_version(), gf_status_string(status), f[0]);
    free(workspace);
    return status;
}
"""
CPP_PROGRAM = """
#include <graspforce/body_motion.h>
#include <graspforce/certify.h>
#include <graspforce/contact_kinematics.h>
#include <graspforce/contact_forces.h>
#include <graspforce/contact_pose.h>
#include <graspforce/control_step.h>
#include <graspforce/controller.h>
#include <graspforce/friction_bounds.h>
#include <graspforce/friction_step.h>
#include <graspforce/grasp_matrix.h>
#include <graspforce/hand_model.h>
#include <graspforce/joint_filter.h>
#include <graspforce/payload_step.h>
#include <graspforce/pose_fusion.h>
#include <graspforce/precaution_step.h>
#include <graspforce/slip_step.h>
#include <graspforce/solve.h>
#include <graspforce/version.h>
#include <cstdio>
#include <vector>
int main()
{
    const int components[] = {1}, contact_block[] = {0};
    const double p[] = {0.1, 0, 0}, R[] = {1, 0, 0, 0, 1, 0, 0, 0, 1}, w[] = {0, 0, 2, 0, 0, 0}, zero[] = {0}, limit[] = {10};
    gf_structure hand{};
    hand.contacts = hand.blocks = 1;
    hand.components = components;
    hand.contact_block = contact_block;
    std::vector<double> G(6);
    gf_moment_reference reference;
    if (!gf_grasp_matrix(&hand, p, R, G.data(), &reference)) return 1;
    gf_problem problem{};
    problem.G = G.data();
    problem.w = w;
    problem.mu = problem.gamma = problem.min_normal = zero;
    problem.max_normal = limit;
    problem.force_weight = 1;
    double f[1], y[6], z[1], nu_lower[1], nu_upper[1];
    gf_solution solution{};
    solution.f = f;
    solution.y = y;
    solution.z = z;
    solution.nu_lower = nu_lower;
    solution.nu_upper = nu_upper;
    const gf_options options = GF_OPTIONS_DEFAULT;
    std::vector<unsigned char> workspace(gf_workspace_size(&hand));
    const gf_status status = gf_solve(&hand, &problem, &options, workspace.data(), &solution);
    gf_units units;
    gf_residuals residuals;
    gf_problem_units(&hand, &problem, reference.length, nullptr, &units);
    gf_certify(&hand, &problem, &solution, &units, nullptr, z, nullptr, &residuals);
    gf_controlled_grasp grasp{};
    if (gf_targets_size(&grasp) == 0) return 1;
    gf_hand_model model{};
    gf_controller_setup setup{};
    if (gf_hand_dynamics_work_size(&model) != 0 || gf_controller_size(&setup) != 0) return 1;
    gf_tracked_grasp tracked{};
    const gf_joint_filter_inputs no_joints{};
    if (gf_tracking_work_size(&tracked) != 0) return 1;
    const gf_joint_filter_outputs no_states{};
    gf_filter_joints(&no_joints, &no_states);
    gf_body_motion body{}, later;
    gf_motion_after(&body, 1.0, &later);
    gf_friction friction{};
    if (gf_friction_work_size(&friction, 0) != 0) return 1;
    double p_next[3], R_next[9];
    if (gf_interpolate_pose(p, R, p, R, 0.5, p_next, R_next) != 0) return 1;
    std::printf("%s %s %.6f\\n", gf_version(), gf_status_string(status), f[0]);
    return residuals.primal < 1e-8 && residuals.dual < 1e-8 && residuals.gap < 1e-8 ? 0 : 1;
}
"""
EXPECTED = f"{graspforce.__version__} optimal 2.000000\n"


def run(*command: str | Path, environment: dict[str, str] | None = None) -> str:
    result = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False, env=environment)
    assert result.returncode == 0, result.stdout + result.stderr
    return result.stdout


def write_consumer(folder: Path, version: str = "") -> Path:
    consumer = folder / "consumer"
    consumer.mkdir()
    (consumer / "CMakeLists.txt").write_text(LISTS.format(version=version))
    (consumer / "main.c").write_text(C_PROGRAM)
    (consumer / "main.cpp").write_text(CPP_PROGRAM)
    return consumer


def check_consumer(folder: Path, package_dir: Path) -> None:
    """Configure, build and run the C and the C++ program with the package in a folder."""
    version = graspforce.__version__.rsplit(".", 1)[0]
    consumer, build = write_consumer(folder, version), folder / "consumer_build"
    run("cmake", "-S", consumer, "-B", build, f"-Dgraspforce_DIR={package_dir}", "-DCMAKE_BUILD_TYPE=Debug")
    run("cmake", "--build", build)
    for name in ("from_c", "from_cpp"):
        assert run(build / name) == EXPECTED


@pytest.mark.parametrize(
    ("libdir", "options"),
    [("lib/some-linux-gnu", []), ("lib", ["-DBUILD_SHARED_LIBS=ON", "-DCMAKE_BUILD_TYPE=Debug"])],
    ids=["static", "shared"],
)
def test_installed_library_serves_c_and_cpp(tmp_path: Path, libdir: str, options: list[str]) -> None:
    """Static and shared, found by find_package and by pkg-config, in folders of one and of several parts."""
    build, prefix = tmp_path / "build", tmp_path / "prefix"
    run("cmake", "-S", SOURCES, "-B", build, f"-DCMAKE_INSTALL_LIBDIR={libdir}", *options)
    run("cmake", "--build", build)
    run("cmake", "--install", build, "--prefix", prefix)
    headers = {path.name for path in (SOURCES / "include/graspforce").glob("*.h")}
    assert {path.name for path in (prefix / "include/graspforce").iterdir()} == headers
    check_consumer(tmp_path, prefix / libdir / "cmake/graspforce")
    if shutil.which("pkg-config"):
        environment = {**os.environ, "PKG_CONFIG_PATH": str(prefix / libdir / "pkgconfig")}
        flags = run("pkg-config", "--cflags", "--libs", "graspforce", environment=environment).split()
        program = tmp_path / "by_pkg_config"
        run("cc", "-std=c11", tmp_path / "consumer/main.c", *flags, f"-Wl,-rpath,{prefix / libdir}", "-o", program)
        assert run(program) == EXPECTED


def test_python_package_serves_c_and_cpp_from_its_sources(tmp_path: Path) -> None:
    """find_package with get_cmake_dir() builds the library as a part of the calling project."""
    check_consumer(tmp_path, Path(graspforce.get_cmake_dir()))


def test_package_of_another_minor_version_is_not_found(tmp_path: Path) -> None:
    major, minor, _ = graspforce.__version__.split(".")
    consumer = write_consumer(tmp_path, f"{major}.{int(minor) + 1}")
    command = ["cmake", "-S", consumer, "-B", tmp_path / "build", f"-Dgraspforce_DIR={graspforce.get_cmake_dir()}"]
    result = subprocess.run(command, capture_output=True, text=True, timeout=300, check=False)
    assert result.returncode != 0
    assert "compatible with requested version" in " ".join(result.stderr.split())


def test_get_include_is_the_folder_of_the_headers() -> None:
    assert (Path(graspforce.get_include()) / "graspforce/solve.h").is_file()
