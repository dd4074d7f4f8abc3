"""Attacks of strangers have no effect; without TLS, the documented ones have one that the victim sees."""

from __future__ import annotations

import pytest

from benchmarks import strangers

TRIES = 32


@pytest.fixture(scope="module", params=[False, True], ids=["without TLS", "with TLS"])
def scene(request):
    with strangers.start_scene(request.param) as started:
        yield started


@pytest.mark.parametrize("attack", [name for name in strangers.ATTACKS if name != "cancel"])
def test_attacks_have_no_effect(scene, attack):
    row = strangers.ATTACKS[attack](scene, TRIES)
    assert row.tries == TRIES
    if scene.mode == "with TLS" or attack not in strangers.VISIBLE:
        assert row.effects == 0
    if scene.mode == "without TLS" and attack in ("states", "replay", "commands", "codes", "close", "reopen"):
        assert row.counted > 0
    assert scene.step()


def test_only_the_owner_of_a_plan_cancels_it_with_tls(scene):
    row = strangers.cancel_plans(scene, TRIES)
    assert (row.effects > 0) == (scene.mode == "without TLS")


def test_connections_without_a_certificate_of_the_authority_are_refused():
    rows = strangers.refuse_certificates(1)
    assert [row.effects for row in rows] == [0, 0]
    assert [row.counted for row in rows] == [1, 1]
