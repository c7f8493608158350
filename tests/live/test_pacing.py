"""An edge that is to be as slow as the paper's takes what its service profile says, drawn by the request's number."""

import numpy as np
import pytest

from ovibjax.edge.service import EDGE, estimate_ms
from ovibjax.live.pacing import Pace
from ovibjax.views import MODES
from tests.live.edges import a_client, an_edge, events, run
from tests.live.test_edge_server import packet

PAPER = Pace(paper_speed=1.0)


@pytest.mark.parametrize("mode", MODES)
def test_the_estimate_and_the_draws_are_those_of_the_profile(mode):
    number = list(MODES).index(mode)
    assert PAPER.expected_ms(mode) == pytest.approx(float(estimate_ms(EDGE, number)), rel=1e-6)
    drawn_ms = np.array([PAPER.least_ms(mode, client, sequence) for client in range(20) for sequence in range(200)])
    before_ms = PAPER.expected_ms(mode) - float(EDGE.jitter_median_ms)
    logarithm = np.log((drawn_ms - before_ms) / float(EDGE.jitter_median_ms))
    assert abs(logarithm.mean()) < 4 * 0.5 / np.sqrt(len(drawn_ms))
    assert logarithm.std() == pytest.approx(float(EDGE.jitter_sigma), rel=0.05)
    assert len(set(drawn_ms)) == len(drawn_ms)


def test_a_draw_depends_on_the_number_of_the_request_alone():
    assert PAPER.least_ms("FS", 3, 7) == Pace(paper_speed=1.0).least_ms("FS", 3, 7)
    assert Pace(paper_speed=6.0).least_ms("FS", 3, 7) == pytest.approx(PAPER.least_ms("FS", 3, 7) / 6)
    assert Pace(5.0).least_ms("FS", 3, 7) == Pace(5.0).expected_ms("A5") == 5.0
    assert Pace(50.0, 1.0).least_ms("FS", 3, 7) == 50.0
    assert Pace().least_ms("FS", 3, 7) == 0.0


def test_services_last_as_long_as_planned(edge_model, tmp_path):
    log = tmp_path / "log.jsonl"

    async def test():
        edge = an_edge(edge_model, log, rule="fifo", paper_speed=2.0, in_flight=64)
        async with edge as server, a_client(server.port) as client:
            await client.ask(*(packet(i) for i in range(10)))

    run(test())
    served = events(log, "request")
    assert len(served) == 10
    for event in served:
        planned_ms = Pace(paper_speed=2.0).least_ms(event["mode"], event["client"], event["sequence"])
        assert event["service_ms"] > planned_ms - 0.01
    assert served[0]["service_est_ms"] == pytest.approx(PAPER.expected_ms("FS") / 2)
    assert events(log, "start")[0]["paper_speed"] == 2.0
