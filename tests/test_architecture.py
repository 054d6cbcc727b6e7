"""The shape of the package: imports point one way, and heavy packages stay out of what does not need them."""

import ast
import subprocess
import sys
from functools import cache
from graphlib import TopologicalSorter
from pathlib import Path

import pytest

PACKAGE = Path(__file__).parent.parent / "robustopt"

LAYERS = [
    ["arrays", "compiled", "errors", "evidence", "files", "models", "tasks", "views", "worker"],
    ["interruption"],
    ["processes"],
    ["config/document", "config/section"],
    ["config/execution_model", "config/learning_model"],
    ["config/object_model", "config/path_model", "config/per_name"],
    ["config/model"],
    ["config/words"],
    ["config/limits_file"],
    ["geometry"],
    ["scene", "scene/placement", "scene/rail"],
    ["scene/patches"],
    ["config/scene_check", "config/step_check", "config/held_check", "config/path_check"],
    ["config/check"],
    ["config/validate"],
    ["config/load"],
    ["config", "config/schema"],
    ["recordings/recording"],
    ["recordings/tables", "recordings/messages"],
    ["recordings/read"],
    ["recordings"],
    ["robot/urdf_check", "robot/model_check"],
    ["robot/inertia", "robot/meshes", "robot/joint_count"],
    ["robot/urdf_inertia"],
    ["robot/urdf", "robot/model_parts", "robot/sources"],
    ["robot/model_file"],
    ["robot/listing"],
    ["robot/locking", "robot/soles", "robot/hands", "robot/floating_base"],
    ["robot/preparation"],
    ["robot/joint_limits", "robot/dynamics", "robot/cartesian"],
    ["robot/robot"],
    ["robot"],
    ["path/pose_path", "path/footsteps"],
    ["path/inverse_kinematics"],
    ["path/path"],
    ["path/branches", "path/collision", "path/joint_waypoints", "path/upright"],
    ["path/reach"],
    ["path/walking_path"],
    ["path/build"],
    ["path"],
    ["limits/names", "limits/facets", "limits/cones", "limits/twist", "limits/bodies"],
    ["limits/laws"],
    ["limits/systems"],
    ["limits/stances", "limits/hands", "limits/load_sharing", "limits/uncertainty"],
    ["limits/turning"],
    ["limits/coupling"],
    ["limits/row_values", "limits/clipping"],
    ["limits/row_bounds"],
    ["limits/cutting", "limits/grid", "limits/motion"],
    ["limits/polygons"],
    ["limits/formulas"],
    ["limits/wrenches", "limits/generalised_force", "limits/contact_limit"],
    ["limits/torque_sharing"],
    ["limits/torque", "limits/cartesian"],
    ["limits/track"],
    ["limits/limit", "limits/contacts", "limits/speed_between"],
    ["limits/problem"],
    ["limits"],
    ["solvers/linear_program", "solvers/plan", "solvers/interior_point", "solvers/jerk_matrix"],
    ["solvers/jerk_slacks"],
    ["solvers/jerk_newton"],
    ["solvers/binding"],
    ["solvers/reachability", "solvers/force_program", "solvers/jerk_program"],
    ["solvers/ipopt", "solvers/sharing", "solvers/jerk_start"],
    ["solvers/jerk"],
    ["solvers/ipopt_jerk"],
    ["solvers/solve"],
    ["solvers/refine"],
    ["solvers/build"],
    ["solvers"],
    ["solvers/batch", "solvers/remedies", "solvers/trajectory"],
    ["exports"],
    ["solvers/diagnosis", "solvers/replan"],
    ["solvers/planner"],
    ["solvers/contact_forces"],
    ["certificate"],
    ["confidence"],
    [
        "simulation/parameters",
        "simulation/cluster",
        "simulation/controller",
        "simulation/disturbance",
        "simulation/simulation",
    ],
    ["simulation/physics", "simulation/outcome"],
    ["simulation/gains"],
    ["simulation/drives", "simulation/feedback"],
    ["simulation/interfaces"],
    ["simulation/ground", "simulation/objects"],
    ["simulation/holding", "simulation/pictures"],
    ["simulation/world"],
    ["simulation/monte_carlo"],
    ["simulation/execute"],
    ["simulation/trace"],
    ["simulation/video", "simulation"],
    ["learning/moments", "learning/parameters", "learning/settings", "learning/sequential", "learning/earned"],
    ["learning/survival"],
    ["learning/outcomes"],
    ["learning/learner"],
    ["learning/bisection", "learning/acceleration_interval", "learning/ilrobs", "learning/calibrated"],
    ["learning/monotone", "learning/cost_map", "learning/boundary"],
    ["learning/branch_and_bound", "learning/foresight"],
    ["learning/informed", "learning/world"],
    ["learning/physics"],
    ["learning/from_config"],
    ["learning"],
    ["runs/records"],
    ["runs/store"],
    ["runs/origin"],
    ["runs/plan_run", "runs/stored_plan"],
    ["runs/execution_run", "runs/export_run"],
    ["runs/journal"],
    ["runs/beliefs", "runs/executors", "runs/foresight", "runs/manual"],
    ["runs/campaign"],
    ["runs/learning_summary", "runs/learning_table"],
    ["runs/learning_run", "runs/listing"],
    ["runs"],
    ["tables", "frames", "plotting"],
    ["plotting/views"],
    ["page"],
    ["report"],
    ["cli"],
    ["__main__"],
]
"""The table of contents of the method: a module imports only from layers above its own, or from its own layer.

A package stands for its `__init__` and for those of its modules that have no place of their own.
"""

HEAVY = {
    "mujoco": {
        "robot",
        "path/inverse_kinematics",
        "path/collision",
        "simulation",
    },
    "casadi": {"solvers/ipopt", "solvers/ipopt_jerk"},
    "highspy": {"solvers/linear_program"},
    "matplotlib": {"plotting"},
    "pandas": {"frames", "tables"},
}
"""The only places that import these packages."""


@cache
def modules() -> dict[str, Path]:
    """Files by name: `robot/urdf`; a package's own name for its `__init__`."""
    files = {path.relative_to(PACKAGE).with_suffix("").as_posix(): path for path in PACKAGE.rglob("*.py")}
    return {name.removesuffix("/__init__"): path for name, path in files.items() if name != "__init__"}


@cache
def imports(path: Path, types: bool = True) -> set[str]:
    """Dotted names of everything a module imports anywhere in its text; types: those for types alone too."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    for node in ast.walk(tree):
        if not types and isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            node.body = []
    names = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{path}: relative import"
            assert node.module is not None
            names |= {f"{node.module}.{alias.name}" for alias in node.names}
    return names


def module_of(imported: str) -> str | None:
    """The module of ours that a dotted name is, or is in."""
    parts = imported.split(".")
    if parts[0] != "robustopt":
        return None
    names = ("/".join(parts[1:end]) for end in range(len(parts), 1, -1))
    return next((name for name in names if name in modules()), None)


def layer_of(name: str) -> int:
    layers = {member: level for level, layer in enumerate(LAYERS) for member in layer}
    package = name.rsplit("/", 1)[0]
    assert name in layers or package in layers, f"{name} has no place among the layers"
    return layers.get(name, layers.get(package, -1))


def test_layers_name_what_there_is() -> None:
    assert {member for layer in LAYERS for member in layer} <= set(modules())


@pytest.mark.parametrize("name", sorted(modules()))
def test_imports_point_one_way(name: str) -> None:
    for imported in imports(modules()[name]):
        module = module_of(imported)
        if module is not None:
            assert layer_of(module) <= layer_of(name), f"{name} imports {imported}, which is below it"


def test_no_imports_go_round_in_a_circle() -> None:
    """Those for types alone count, a module's own package does not."""
    graph = {name: {module_of(imported) for imported in imports(path)} for name, path in modules().items()}
    TopologicalSorter({name: found - {None, name, name.rsplit("/", 1)[0]} for name, found in graph.items()}).prepare()


@pytest.mark.parametrize("package", sorted(HEAVY))
def test_heavy_packages_are_imported_in_their_places_only(package: str) -> None:
    users = {name for name, path in modules().items() if any(i.split(".")[0] == package for i in imports(path, False))}
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


def test_functions_compile_where_nothing_can_be_kept(monkeypatch):
    from numba.core import caching

    from robustopt.compiled import compiled

    def twice(x):
        return 2 * x

    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [])
    assert compiled()(twice)(3) == 6
