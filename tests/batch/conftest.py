"""A small project that the tests of batches share."""

import pytest
from projects import Project, make_project


@pytest.fixture(scope="session")
def project(tmp_path_factory) -> Project:
    """Four small clouds, six pairs."""
    return make_project(tmp_path_factory.mktemp("project"), clouds=4, points=400)
