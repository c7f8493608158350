"""What several commands share: numbers as typed, and misspelt options."""

import pytest

from ovibjax.cli.commands import check_options
from ovibjax.cli.options import integers, numbers
from ovibjax.errors import InputError


def test_values_are_parsed():
    assert integers("seed", ("0:3", "7"), 0, 9) == [0, 1, 2, 7]
    assert numbers("beta", ("1e-4", "0"), lambda value: value >= 0, "zero or more") == [1e-4, 0.0]
    with pytest.raises(InputError, match="--beta nan"):
        numbers("beta", ("nan",), lambda value: value >= 0, "zero or more")


def test_options_are_checked_per_command():
    check_options(["show", "runs/a.zarr", "--plot=gamma"])
    check_options(["sweep", "train", "--no-keep-params", "--weight_decay", "0"])
    with pytest.raises(InputError, match="did you mean --preset"):
        check_options(["reproduce", "--prset", "full"])
