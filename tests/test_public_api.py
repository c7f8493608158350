"""The public face: what each room offers, that it is there and explained, and that every example runs."""

import importlib
import pkgutil
import subprocess
import sys

import pytest

import ovibjax as ob

PUBLIC = {
    "ovibjax": """FeatureSet InputError cards cli control edge encoder features link load_features make_feature_set
        report reproduce room_features runtime scheduling sweep system town_features views world""",
    "ovibjax.cards": "CardInterrupted Job PRESETS card_names card_paths load_card load_features load_pair",
    "ovibjax.cli": "Best Features Replay Reproduce Show SweepSystem SweepTrain Town check_options",
    "ovibjax.features": """CONTEXTS FeatureSet Split backbones describe extract fit_basis images load make_feature_set
        open_backbone open_source project save split_indices""",
    "ovibjax.features.backbones": "Backbone BackboneOptions fingerprint normalise open_backbone resize_and_crop",
    "ovibjax.features.images": """CODECS Extraction Frame LADDERS Skipped Source decode decode_image encode extract
        open_source""",
    "ovibjax.report": """Claim Interval band bars choose interval plot select sheet table variance_shares write_claims
        write_csv write_page""",
    "ovibjax.sweep": "Along Axis Interrupted best config_of on_ray open_dataset run take tree_of",
    "ovibjax.world": """Camera RoomConfig TownConfig contact_sheet context_labels make_room make_route make_town
        platform_room render render_interior room_features rooms town town_features write_frames""",
}
"""Public names by package; what is not written here may change from one version to the next."""


def names(package):
    return sorted(PUBLIC[package].split())


@pytest.mark.parametrize("package", PUBLIC)
def test_public_names(package):
    module = importlib.import_module(package)
    assert sorted(module.__all__) == names(package)
    assert set(names(package)) <= set(dir(module))


@pytest.fixture(scope="module")
def everything():
    """Every module imported, so that none can stand in the way of a public name."""
    for found in pkgutil.walk_packages(ob.__path__, "ovibjax."):
        if not found.name.endswith("__main__"):
            importlib.import_module(found.name)


@pytest.mark.parametrize("package", PUBLIC)
def test_every_public_name_is_there_and_explained(package, everything):
    module = importlib.import_module(package)
    for name in names(package):
        value = getattr(module, name)
        assert value.__doc__, f"{package}.{name} has no docstring"
        shadow = f"{package}.{name}"
        assert shadow not in sys.modules or sys.modules[shadow] is value, f"{shadow} is a module as well"


def test_importing_loads_no_jax():
    code = "import sys, ovibjax as ob; assert dir(ob) and ob.__version__; sys.exit('jax' in sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)
