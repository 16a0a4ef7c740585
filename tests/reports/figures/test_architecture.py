"""Diagrams of networks."""

from pathlib import Path

import pytest
from tests.support.figures import assert_no_text_overlaps_or_is_cut

from eitbench.benchmark.studies.architecture import published_networks
from eitbench.reports.figures.architecture import TITLES, draw, write_architectures


@pytest.mark.slow
def test_the_published_networks_are_drawn_and_can_be_read(tmp_path: Path) -> None:
    networks = published_networks()
    for name, layers in networks.items():
        figure = draw(layers, *TITLES[name])
        assert_no_text_overlaps_or_is_cut(figure)
        words = [text.get_text() for text in figure.axes[0].texts]
        for layer in layers[1:-1]:
            assert layer.kind in words
    written = write_architectures(networks, tmp_path)
    assert [path.name for path in written[::2]] == [f"architecture-{name}.png" for name in networks]
