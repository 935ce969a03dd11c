"""Plans of the shipped files by the whole search: the table of docs/planning.md, the same on every processor."""

import re
from pathlib import Path

import pytest

from sims.scenarios.library import names
from sims.scenarios.plan_file import load_plan_file
from srt.planning.planner import make_plan, table_1_plan

PAGE = Path(__file__).parents[2] / "docs" / "planning.md"


@pytest.mark.campaign
@pytest.mark.parametrize("name", names("plan"))
def test_plans_and_those_of_table_1_are_those_of_the_page(name):
    row = re.search(rf"^\| `{name}` \| (\S+) \| (\S+) \| \d+ % \| (\S+) \| (\d+) \|$", PAGE.read_text(), re.MULTILINE)
    file = load_plan_file(name)
    arguments = file.stand.kinematics(), file.conditions(), file.targets.sigma()
    total_s, limits = file.plan.total_time_s, file.plan.limits()
    plan = make_plan(*arguments, total_s=total_s, limits=limits)
    table_1 = table_1_plan(*arguments, total_s, limits)
    assert plan.total_s <= total_s * (1.0 + 1e-6)
    assert plan.bound < plan.ratio < table_1.ratio
    found = [f"{value:.3f}" for value in (plan.ratio, table_1.ratio, plan.bound)]
    assert [*found, str(len(plan.candidates))] == list(row.groups())
