"""The 20 EOP sets on the twin have known numbers and names of undetermined directions."""

from __future__ import annotations

import pytest

from fg_orient.model.block import Block
from fg_orient.model.errors import RankDeficientError
from fg_orient.orientation.orient import adjust
from fg_orient.simulate.zonguldak import ZonguldakOptions, zonguldak_block

pytestmark = pytest.mark.behaviour

#: Issue 2, "Observability"; per image. Sets 7 and 8 may differ by one: a singular value lies near the limit.
RANK_DEFECT = {5: 6, 6: 1, 7: 1, 8: 2, 13: 6, 14: 1, 17: 9, 18: 2, 19: 2, 20: 9}
NEAR_THE_LIMIT = (7, 8)
YAW = "velocity across track acts as yaw"


@pytest.fixture(scope="module", params=[1, 2])
def block(request: pytest.FixtureRequest) -> Block:
    return zonguldak_block(ZonguldakOptions(seed=request.param))[0]


@pytest.mark.parametrize("eop_set", range(1, 21))
def test_rank_defect_and_sentences(block: Block, eop_set: int) -> None:
    solution = adjust(block, eop_set=eop_set)
    expected, slack = RANK_DEFECT.get(eop_set, 0), int(eop_set in NEAR_THE_LIMIT)
    assert set(solution.rank_defect) == {"left", "right"}
    for found in solution.observability:
        assert abs(found.rank_defect - expected) <= slack
        assert len(found.sentences) == found.rank_defect
        assert len(set(found.sentences)) == len(found.sentences), "each direction is named once"
        assert all(sentence.startswith(f"image {found.image}: ") for sentence in found.sentences)
        # every dead direction of these sets has a physical name
        named = [YAW, "radial velocity", "velocity along track"]
        assert all(any(name in sentence for name in named) for sentence in found.sentences), found.sentences


@pytest.mark.parametrize(("eop_set", "count"), [(17, 3), (18, 1), (19, 1), (20, 3)])
def test_the_near_duplicate_is_named(block: Block, eop_set: int, count: int) -> None:
    """Sets with velocity and yaw state for each degree that yaw of the velocity and of the attitude are alike."""
    for found in adjust(block, eop_set=eop_set).observability:
        assert sum(YAW in sentence for sentence in found.sentences) == count


@pytest.mark.parametrize("eop_set", sorted(RANK_DEFECT))
def test_without_priors_these_sets_are_refused(block: Block, eop_set: int) -> None:
    with pytest.raises(RankDeficientError) as caught:
        adjust(block, eop_set=eop_set, priors=False)
    assert caught.value.exit_code == 3
    places = [p.place for p in caught.value.problems]
    assert {p.code for p in caught.value.problems} == {"adjust.rank_deficient"}
    assert tuple(places) == adjust(block, eop_set=eop_set).unobservable


@pytest.mark.parametrize("eop_set", sorted(set(range(1, 21)) - set(RANK_DEFECT)))
def test_without_priors_the_others_are_solved(block: Block, eop_set: int) -> None:
    solution = adjust(block, eop_set=eop_set, priors=False)
    assert solution.unobservable == ()
    assert solution.status.value in ("converged", "not_trustworthy")
