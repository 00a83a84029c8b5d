"""Parameters: declared with description, type and range; wrong values refused. Oracle: ROS's own parameter services."""

import math
from pathlib import Path

import pytest
import yaml
from rcl_interfaces.srv import DescribeParameters
from rclpy.node import Node
from rclpy.parameter import Parameter

from jpap_ros.nodes.parameters import Param, StartError, declare, values
from jpap_ros.nodes.planner_parameters import PLAN_PARAMETERS, plan_settings, planner_parameters
from jpap_ros.planning import LinkBudget

PARAMS = (
    Param("height_m", 50.0, "Height [m]", 1.0, 100.0),
    Param("count", 3, "How many", 0, 10),
    Param("colour", "red", "Which", choices=("red", "green")),
    Param("word", "x", "Not empty", check=lambda text: None if text else "must not be empty"),
    Param("origin", 0.0, "Fixed [m]", -1.0, 1.0, fixed=True),
    Param("free", 0.0, "Any number"),
)


@pytest.fixture
def make_node(graph):
    """Return a function that makes a node with parameters given at start."""
    made = []

    def make(**overrides):
        given = [Parameter(name, value=value) for name, value in overrides.items()]
        made.append(Node("parameterized", context=graph.node.context, parameter_overrides=given))
        return made[-1]

    yield make
    for node in made:
        node.destroy_node()


def test_defaults_hold_and_values_given_at_start_replace_them(make_node):
    node = make_node(height_m=60.0)
    declare(node, PARAMS)
    assert values(node, PARAMS) == {
        "height_m": 60.0, "count": 3, "colour": "red", "word": "x", "origin": 0.0, "free": 0.0
    }  # fmt: skip


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("height_m", 0.5),
        ("height_m", math.nan),
        ("height_m", math.inf),
        ("height_m", "tall"),
        ("count", 11),
        ("count", -1),
        ("colour", "blue"),
        ("word", ""),
        ("origin", 2.0),
        ("free", math.nan),
        ("free", -math.inf),
    ],
)
def test_a_wrong_value_stops_the_start_with_one_line_that_names_it(make_node, name, value):
    with pytest.raises(StartError) as error:
        declare(make_node(**{name: value}), PARAMS)
    assert name in str(error.value) and str(value) in str(error.value) and "\n" not in str(error.value)


def test_at_run_time_good_values_are_told_and_wrong_ones_refused(make_node):
    node, told = make_node(), []
    declare(node, PARAMS, told.append)

    def put(name, value):
        return node.set_parameters([Parameter(name, value=value)])[0]

    assert put("colour", "green").successful
    assert told == [{"colour": "green"}]
    wrong = [
        ("colour", "blue"),
        ("height_m", 1e3),
        ("height_m", math.nan),
        ("free", math.inf),
        ("origin", 0.5),
        ("word", ""),
    ]
    for name, value in wrong:
        refused = put(name, value)
        assert not refused.successful and name in refused.reason, (name, refused.reason)
    assert told == [{"colour": "green"}]
    assert values(node, PARAMS)["height_m"] == 50.0


def test_a_change_of_several_is_all_or_nothing(make_node):
    node, told = make_node(), []
    declare(node, PARAMS, told.append)
    result = node.set_parameters_atomically([Parameter("count", value=5), Parameter("colour", value="blue")])
    assert not result.successful and told == [] and values(node, PARAMS)["count"] == 3


def test_the_graph_sees_description_and_range(make_node, graph):
    node = make_node()
    declare(node, PARAMS)
    graph.add_node(node)
    answer = graph.call(
        DescribeParameters,
        "/parameterized/describe_parameters",
        DescribeParameters.Request(names=["height_m", "count"]),
    )
    height, count = answer.descriptors
    assert height.description == "Height [m]" and count.description == "How many"
    assert (height.floating_point_range[0].from_value, height.floating_point_range[0].to_value) == (1.0, 100.0)
    assert (count.integer_range[0].from_value, count.integer_range[0].to_value) == (0, 10)


def test_every_parameter_of_the_planner_is_described_and_every_number_has_a_range():
    for param in planner_parameters():
        assert param.description, param.name
        if type(param.default) in (int, float):
            assert param.low is not None and param.low <= param.default <= param.high, param.name


def test_the_shipped_parameters_file_holds_the_defaults():
    path = Path(__file__).parents[1] / "config" / "params.yaml"
    shipped = yaml.safe_load(path.read_text())["/**/planner"]["ros__parameters"]
    declared = {param.name: param.default for param in planner_parameters()}
    for launch_argument in ("fleet_file", "scheme"):
        del declared[launch_argument]
    assert shipped == declared
    assert {name: type(value) for name, value in shipped.items()} == {n: type(v) for n, v in declared.items()}


def test_the_default_settings_are_those_of_the_planning_layer():
    settings = plan_settings({param.name: param.default for param in planner_parameters()})
    assert settings.link == LinkBudget()
    assert settings.max_devices_per_uav is None and settings.min_separation_m == 15.0


def test_parameters_that_make_another_plan_exist():
    assert {param.name for param in planner_parameters()} >= PLAN_PARAMETERS
