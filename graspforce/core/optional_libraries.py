"""Optional libraries: the extra of graspforce that installs each, and the error if one is missing."""

from __future__ import annotations

import contextlib
import importlib.util
from collections.abc import Iterator
from typing import NamedTuple

from graspforce.core.errors import MissingLibrary


class OptionalLibrary(NamedTuple):
    """A library that graspforce does not always need.

    Args:
        name: its own name.
        users: the features that need it, in the plural.
        extra: the extra of graspforce that installs it.
    """

    name: str
    users: str
    extra: str


LIBRARIES = {
    "pinocchio": OptionalLibrary("Pinocchio", "hands", "hand"),
    "coal": OptionalLibrary("Coal", "collision shapes", "hand"),
    "casadi": OptionalLibrary("CasADi", "minimum-time moves", "plan"),
    "matplotlib": OptionalLibrary("Matplotlib", "plots", "plot"),
    "zenoh": OptionalLibrary("Zenoh", "server and client", "serve"),
    "json5": OptionalLibrary("json5", "Zenoh's configuration files", "serve"),
    "threadpoolctl": OptionalLibrary("threadpoolctl", "servers", "serve"),
    "mujoco": OptionalLibrary("MuJoCo", "simulations", "sim"),
    "imageio": OptionalLibrary("imageio", "films", "sim"),
    "PIL": OptionalLibrary("Pillow", "films", "sim"),
    "viser": OptionalLibrary("viser", "browser views", "view"),
    "foxglove": OptionalLibrary("foxglove-sdk", "MCAP files", "record"),
    "mcap": OptionalLibrary("mcap", "recordings of servers", "record"),
    "trimesh": OptionalLibrary("trimesh", "mesh files", "mesh"),
    "cryptography": OptionalLibrary("cryptography", "certificates for TLS", "secure"),
    "prometheus_client": OptionalLibrary("prometheus-client", "metrics", "metrics"),
    "rosbags": OptionalLibrary("rosbags", "messages of ROS 2", "ros2"),
    "sklearn": OptionalLibrary("scikit-learn", "learned models", "learn"),
    "torch": OptionalLibrary("PyTorch", "differentiable forces", "torch"),
    "jax": OptionalLibrary("JAX", "differentiable forces", "jax"),
    "distributed": OptionalLibrary("Dask", "clusters", "cluster"),
    "pyarrow": OptionalLibrary("pyarrow", "Parquet files", "learn"),
}


@contextlib.contextmanager
def optional_imports(*modules: str) -> Iterator[None]:
    """Raise `MissingLibrary` if an import in the block fails because an optional library is not installed.

    Args:
        modules: libraries to check first: keys of `LIBRARIES`. The error names the extra of the first one that is missing.
    """
    require_libraries(*modules)
    try:
        yield
    except ModuleNotFoundError as error:
        if error.name is None or error.name.partition(".")[0] not in LIBRARIES:
            raise
        raise _missing(error.name.partition(".")[0]) from None


def require_libraries(*modules: str) -> None:
    """Check that optional libraries are installed, without importing them.

    Args:
        modules: their modules: keys of `LIBRARIES`.

    Raises:
        MissingLibrary: one of them is not installed.
    """
    for module in modules:
        if importlib.util.find_spec(module) is None:
            raise _missing(module)


def _missing(module: str) -> MissingLibrary:
    return MissingLibrary(module, *LIBRARIES[module])
