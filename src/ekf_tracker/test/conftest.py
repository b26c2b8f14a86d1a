import pytest

from stick_figure.body import Body


@pytest.fixture(scope="session")
def body():
    return Body.from_stature(1.75)


@pytest.fixture(scope="session")
def person(body):
    from ekf_person import Person

    return Person(body)
