"""Body, person and node of the tests of the filter."""

import pytest
from ekf_probe import EkfProbe

from stick_figure.body import Body
from stick_figure.body_file import save_body


@pytest.fixture(scope="session")
def body():
    return Body.from_stature(1.75)


@pytest.fixture(scope="session")
def person(body):
    from ekf_person import Person

    return Person(body)


@pytest.fixture
def bench(open_probe):
    """bench(parameter=value, ...): a node with these parameters, not yet started; ``__`` in names stands for a dot."""
    return lambda **given: open_probe(EkfProbe, **{name.replace("__", "."): value for name, value in given.items()})


@pytest.fixture
def body_file(body, tmp_path):
    save_body(body, tmp_path / "body.yaml")
    return str(tmp_path / "body.yaml")
