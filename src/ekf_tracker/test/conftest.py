import sys
from pathlib import Path

import pytest

from stick_figure.body import Body

sys.path.insert(0, str(Path(__file__).parent))  # ekf_person: the motion that these tests share


@pytest.fixture(scope="session")
def body():
    return Body.from_stature(1.75)


@pytest.fixture(scope="session")
def person(body):
    from ekf_person import Person

    return Person(body)
