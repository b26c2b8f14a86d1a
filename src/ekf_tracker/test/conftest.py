"""Body, person and node of the tests of the filter."""

import pytest
from ekf_probe import EkfProbe


@pytest.fixture(scope="session")
def person(body):
    from ekf_person import Person

    return Person(body)


@pytest.fixture
def bench(open_probe, body):
    """bench(parameter=value, ...): a node with these parameters, not yet started, whose tracker sends the body.

    ``__`` in names stands for a dot.
    """

    def make(body=body, **given):
        return open_probe(EkfProbe, body, **{name.replace("__", "."): value for name, value in given.items()})

    return make
