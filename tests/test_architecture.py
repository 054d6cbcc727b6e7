"""The shape of the package: imports point one way, and heavy packages stay out of what does not need them."""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "robustopt"

LAYERS = [
    ["errors"],
    ["config_words", "config_model", "config_yaml"],
    ["geometry"],
    ["scene_check", "step_check", "config_check", "config_validate"],
    ["config", "schema"],
    ["urdf"],
    ["robot_model"],
    ["walker_model"],
    ["joint_limits"],
    ["robot"],
    ["walker"],
    ["tray_path"],
    ["inverse_kinematics"],
    ["branches"],
    ["reach", "collision", "joint_waypoints"],
    ["path"],
    ["footsteps"],
    ["walking_path"],
    ["contact"],
    ["stances"],
    ["uncertainty"],
    ["cutting"],
    ["polygons"],
    ["rows"],
    ["walking"],
    ["load_sharing"],
    ["track"],
    ["problem"],
    ["timescaling"],
    ["batch", "diagnosis", "certificate", "trajectory"],
    ["foot_forces"],
    ["confidence"],
    ["execution"],
    ["learning"],
    ["store"],
    ["experiment"],
    ["execution_run"],
    ["tasks"],
    ["beliefs"],
    ["journal"],
    ["executors", "manual"],
    ["campaign"],
    ["learning_summary"],
    ["learning_run", "runs"],
    ["learning_table"],
    ["tables", "plotting"],
    ["report"],
    ["terminal"],
    ["interruption"],
    ["commands"],
    ["cli"],
]
"""The table of contents of the method: a module imports only from layers above its own, or from its own layer."""

HEAVY = {
    "mujoco": {
        "urdf",
        "robot_model",
        "joint_limits",
        "robot",
        "walker_model",
        "walker",
        "inverse_kinematics",
        "collision",
        "execution",
    },
    "casadi": {"timescaling/ipopt"},
    "highspy": {"timescaling/linear_program"},
    "matplotlib": {"plotting"},
}
"""The only places that import these packages."""


def modules() -> dict[str, Path]:
    return {
        path.relative_to(PACKAGE).with_suffix("").as_posix(): path
        for path in PACKAGE.rglob("*.py")
        if path.name != "__init__.py" or path.parent != PACKAGE
    }


def imports(path: Path) -> set[str]:
    """Dotted names of everything a module imports anywhere in its text, apart from imports for types alone."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            node.body = []
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module is not None
            names |= {node.module} | {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def layer_of(name: str) -> int:
    top = name.split("/")[0]
    for level, layer in enumerate(LAYERS):
        if top in layer:
            return level
    raise AssertionError(f"{name} has no place among the layers")


@pytest.mark.parametrize("name", sorted(modules()))
def test_imports_point_one_way(name: str) -> None:
    own = layer_of(name)
    for imported in imports(modules()[name]):
        parts = imported.split(".")
        if parts[0] == "robustopt" and len(parts) > 1 and parts[1] != "__version__":
            assert layer_of(parts[1]) <= own, f"{name} imports {imported}, which is below it"


@pytest.mark.parametrize("package", sorted(HEAVY))
def test_heavy_packages_are_imported_in_their_places_only(package: str) -> None:
    users = {name for name, path in modules().items() if any(i.split(".")[0] == package for i in imports(path))}
    strangers = {user for user in users if not {user, user.split("/")[0]} & HEAVY[package]}
    assert users, f"nobody imports {package}"
    assert not strangers


def test_help_loads_no_heavy_package() -> None:
    code = (
        "import sys\nfrom robustopt.cli import run\nrun(['--help'])\n"
        "heavy = ('casadi', 'mujoco', 'numba', 'matplotlib', 'scipy', 'pandas')\n"
        "print('LOADED', [m for m in heavy if m in sys.modules])"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True).stdout
    assert "plan" in output
    assert output.strip().endswith("LOADED []")


def test_the_library_says_its_names() -> None:
    import robustopt

    for name in ("load_config", "build_problem", "solve", "certify"):
        assert callable(getattr(robustopt, name))
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        _ = robustopt.nonsense
