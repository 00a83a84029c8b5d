"""Launch files, read as Python source: launch itself is no part of the development environment.

Oracle: setup.py's entry points, the declared arguments of each file, and the files that config/ holds.
"""

import ast
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted((ROOT / "launch").glob("*.launch.py"))


def tree(path):
    return ast.parse(path.read_text(), filename=str(path))


def calls(path, name):
    """Return every call of a function or class by that name."""
    return [n for n in ast.walk(tree(path)) if isinstance(n, ast.Call) and getattr(n.func, "id", "") == name]


def keyword(call, name):
    return next((k.value for k in call.keywords if k.arg == name), None)


def declared(path):
    return {call.args[0].value: call for call in calls(path, "DeclareLaunchArgument")}


def executables():
    """Names of console_scripts in setup.py."""
    source = (ROOT / "setup.py").read_text()
    strings = [n for n in ast.walk(ast.parse(source)) if isinstance(n, ast.JoinedStr)]
    return {s.values[0].value.split(" =")[0] for s in strings if " = " in str(getattr(s.values[0], "value", ""))}


def launched():
    """Executables that are part of a flight: a replay stands alone, takes a recording and ends."""
    return executables() - {"replay"}


def test_there_is_one_for_each_executable_and_one_for_all():
    assert {path.name.removesuffix(".launch.py") for path in FILES} == {*launched(), "jpap"}


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_argument_has_a_default_and_a_description(path):
    arguments = declared(path)
    assert {"fleet_file", "namespace", "params_file", "use_sim_time", "log_level"} <= arguments.keys()
    for name, call in arguments.items():
        assert keyword(call, "default_value") is not None, name
        assert len(keyword(call, "description").value) > 10, name


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_every_configuration_that_is_read_is_declared(path):
    read = {call.args[0].value for call in calls(path, "LaunchConfiguration") if isinstance(call.args[0], ast.Constant)}
    assert read <= declared(path).keys()


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_the_nodes_it_starts_are_installed(path):
    for call in calls(path, "Node"):
        assert keyword(call, "package").value == "jpap_ros"
        assert keyword(call, "executable").value in executables()
        # The node's own name, so that the keys of the parameters file match.
        assert keyword(call, "name").value == keyword(call, "executable").value


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_the_configuration_files_it_names_exist(path):
    named = {n.value for n in ast.walk(tree(path)) if isinstance(n, ast.Constant) and str(n.value).endswith(".yaml")}
    assert named
    assert all((ROOT / "config" / name).is_file() for name in named)


def test_the_launch_file_for_all_includes_each_node_with_arguments_that_it_declares():
    path = ROOT / "launch" / "jpap.launch.py"
    shared = next(
        ast.literal_eval(n.value)
        for n in ast.walk(tree(path))
        if isinstance(n, ast.Assign) and n.targets[0].id == "SHARED"
    )
    included = [call.args[0].value for call in calls(path, "_include")]
    assert set(included) == launched()
    for node in included:
        assert set(shared) <= declared(ROOT / "launch" / f"{node}.launch.py").keys()
    assert "scheme" in declared(ROOT / "launch" / "planner.launch.py")
    renamed = {k.arg: k.value.value for c in calls(path, "_include") for k in c.keywords if k.arg != "condition"}
    # Only simulated aircraft may fly faster than the clock.
    assert renamed == {"simulated_clock": "sim"} and "sim" in declared(path)
    assert "simulated_clock" in declared(ROOT / "launch" / "bridge.launch.py")


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_it_defines_what_launch_looks_for(path):
    functions = [n.name for n in tree(path).body if isinstance(n, ast.FunctionDef)]
    assert "generate_launch_description" in functions
    compile(path.read_text(), str(path), "exec")
