"""View order, modes and masks against the paper's list."""

import numpy as np
import pytest

from ovibjax.views import MODES, VIEWS, full_mode, mask_table, mode_mask, modes_for
from tests.oracles import encoder as oracle


def test_the_order_of_views_and_modes_is_the_papers():
    assert VIEWS == ("Front", "Back", "Left", "Right", "Down")
    named = {mode: {VIEWS[view] for view in views} for mode, views in MODES.items()}
    assert list(named) == ["F", "FS", "H4", "A5"]
    assert named["F"] == {"Front"}
    assert named["FS"] == {"Front", "Left", "Right"}
    assert named["H4"] == {"Front", "Back", "Left", "Right"}
    assert named["A5"] == set(VIEWS)


@pytest.mark.parametrize(("n_views", "modes"), [(5, ("F", "FS", "H4", "A5")), (4, ("F", "FS", "H4"))])
def test_a_platform_has_the_modes_its_cameras_allow(n_views, modes):
    assert modes_for(n_views) == modes
    assert full_mode(n_views) == modes[-1]
    assert np.all(np.asarray(mode_mask(full_mode(n_views), n_views)) == 1)


@pytest.mark.parametrize("n_views", [5, 4])
def test_masks_equal_the_oracle_and_the_table_stacks_them(n_views):
    table = np.asarray(mask_table(n_views))
    assert table.dtype == np.float32
    assert table.shape == (len(modes_for(n_views)), n_views)
    for row, mode in zip(table, modes_for(n_views), strict=True):
        mask = mode_mask(mode, n_views)
        assert mask.dtype == np.float32
        np.testing.assert_array_equal(mask, oracle.view_mask(mode, n_views))
        np.testing.assert_array_equal(row, mask)
    # Each mode contains the one before.
    assert np.all(np.diff(table, axis=0) >= 0) and np.all(np.diff(table.sum(axis=1)) > 0)


def test_the_default_platform_has_five_views():
    np.testing.assert_array_equal(mode_mask("FS"), [1, 0, 1, 1, 0])
    np.testing.assert_array_equal(mask_table(), mask_table(5))


@pytest.mark.parametrize(("mode", "n_views"), [("A5", 4), ("G", 5), ("", 5), ("f", 4), ("A4", 4)])
def test_a_mode_the_platform_lacks_is_an_error_that_lists_the_others(mode, n_views):
    with pytest.raises(ValueError, match="F, FS, H4"):
        mode_mask(mode, n_views)


@pytest.mark.parametrize("n_views", [0, 1, 3, 6, -5])
@pytest.mark.parametrize("function", [modes_for, full_mode, mask_table, lambda n: mode_mask("F", n)])
def test_other_numbers_of_views_are_an_error(function, n_views):
    with pytest.raises(ValueError, match=str(n_views)):
        function(n_views)
