"""The public face: what each room offers, that it is there and explained, and that every example runs."""

import doctest
import importlib
import pkgutil
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import ovibjax as ob
from ovibjax.control import drives
from ovibjax.features.frames import make_feature_set
from ovibjax.world.town import feature_set

PACKAGE = Path(ob.__file__).parent

PUBLIC = {
    "ovibjax": """FeatureSet InputError cards cli control edge encoder features link live load_features make_feature_set
        report reproduce room_features runtime scheduling sweep system town_features views world""",
    "ovibjax.cards": "CardInterrupted Job PRESETS card_names card_paths load_card load_features load_pair",
    "ovibjax.cli": """Best Doctor EdgeDrive EdgeExport EdgeReport EdgeServe Features Replay Report Reproduce Show
        SweepMerge SweepRun SweepSystem SweepTrain SweepUpgrade Town check_options""",
    "ovibjax.control": """ACTIONS ControlParams Environment POLICIES Prices Route Scene embedded_drives fit_predictor
        make_controller make_environment make_scene net_voi replay summarize""",
    "ovibjax.edge": """ClusterIndex Index TrainAndJudge Trained brute_force build_index calibrate cluster_index
        coarse_to_fine errors judge judge_prefixes leave_one_out mix nearest retrieve select_eta spatial_folds
        summarize""",
    "ovibjax.encoder": """Architecture Hypers MemberData TrainConfig TrainData active_dims ard_kl decode encode fit
        fixed_rate for_bits gaussian_kl init locate make_hypers member_data orthogonality_penalty paper_recipe
        prefix_mask""",
    "ovibjax.features": """CONTEXTS FeatureSet Split backbones describe extract fit_basis images load make_feature_set
        open_backbone open_source project save split_indices""",
    "ovibjax.features.backbones": "Backbone BackboneOptions fingerprint normalise open_backbone resize_and_crop",
    "ovibjax.features.images": """CODECS Extraction Frame LADDERS Skipped Source decode decode_image encode extract
        open_source""",
    "ovibjax.link": """JETSON PayloadError Request Trace draw_gain fading_power kbytes_per_s make_channel_params pack
        profile_rate_bps rate_bps read_trace request_bytes resample semantic_latency_ms transmit_s unpack codes
        CodedRequest pack_coded pack_compact unpack_coded""",
    "ovibjax.link.codes": "CODES CodeTable Coder Grid StreamError fit_table snapped",
    "ovibjax.live": """Answer FrameReader RobotState WireError frame pack_answer pack_request unpack_answer
        unpack_request""",
    "ovibjax.report": """Claim Effects Interval Ranking band bars choose effects interval plot select sheet table
        variance_shares watch write_claims write_csv write_page write_parquet write_results_page write_sweep_page""",
    "ovibjax.runtime": """PRECISIONS cache_folder faster_precision in_order in_threads keep_compiled_programs
        one_blas_thread pool_threads progress_bar workers""",
    "ovibjax.scheduling": """LEVELS POLICIES RequestTrace SchedulerParams TIES Weights default_params
        default_trace_params make_trace metrics recorded_events replay replay_coupled run_grid solve
        synthetic_events""",
    "ovibjax.sweep": """Along Axis Interrupted Range Staged best config_of halve merge on_ray open open_dataset
        random_points run sobol take tree_of""",
    "ovibjax.system": "DIMS HYPERS SystemConfig SystemData SystemSize along make_system run sweep_system",
    "ovibjax.world": """Camera RoomConfig TownConfig contact_sheet context_labels make_room make_route make_town
        platform_room render render_interior room_features rooms town town_features write_frames""",
}
"""Public names by package; what is not written here may change from one version to the next."""


def module_of(path):
    return ".".join(path.relative_to(PACKAGE.parent).with_suffix("").parts).removesuffix(".__init__")


def names(package):
    return sorted(PUBLIC[package].split())


@pytest.mark.parametrize("package", PUBLIC)
def test_public_names(package):
    module = importlib.import_module(package)
    assert sorted(module.__all__) == names(package)
    assert set(names(package)) <= set(dir(module))


def test_every_package_with_a_face_is_listed():
    assert sorted(PUBLIC) == sorted(module_of(path.with_suffix(".py")) for path in PACKAGE.rglob("__init__.pyi"))


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


WITH_EXAMPLES = sorted(module_of(path) for path in PACKAGE.rglob("*.py") if ">>> " in path.read_text())


@pytest.mark.parametrize("name", WITH_EXAMPLES)
def test_examples_in_docstrings_run(name):
    flags = doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE
    failed, attempted = doctest.testmod(importlib.import_module(name), optionflags=flags)
    assert attempted and not failed


SMALLER = {
    "TrainConfig(steps=2000)": "TrainConfig(steps=4)",
    "embedded_drives()": "embedded_drives(slots=80)",
    "SystemSize()": "SystemSize(steps=4, mixed=64, rank=6, clients=2, fleet=3, batch=16)",
}
"""Sizes that make an example of minutes one of seconds, by arguments that a reader could give as well."""


def python_blocks():
    """Every Python example of the README files and guides; those that train are slow."""
    for path in (PACKAGE.parent / "README.md", PACKAGE / "README.md", *sorted((PACKAGE.parent / "docs").glob("*.md"))):
        for i, code in enumerate(re.findall(r"```python\n(.*?)```", path.read_text(), re.DOTALL), start=1):
            trains = any(whole in code for whole in SMALLER)
            name = f"{path.relative_to(PACKAGE.parent)}, example {i}"
            yield pytest.param(code, id=name, marks=[pytest.mark.slow] * trains)


BLOCKS = list(python_blocks())


def small_town(frames, route):
    """Stands in for rendered frames: features that are smooth functions of the place, along a bent line."""
    t = 3.0 * np.arange(frames)
    positions_m = np.stack([t, 20 * np.sin(t / 40 + route), np.full(frames, 20.0)], axis=1)
    mix = np.random.default_rng(0).normal(size=(3, 5 * 64)) / 30
    noise = 0.02 * np.random.default_rng(route).normal(size=(frames, 5 * 64))
    return make_feature_set(
        (np.sin(positions_m @ mix) + noise).reshape(frames, 5, 64),
        positions_m.astype(np.float32),
        yaw_rad=np.zeros(frames),
        context=np.arange(frames) // 10 % 3,
    )


@pytest.mark.parametrize("code", BLOCKS)
def test_examples_in_readmes_run(code, monkeypatch, tmp_path, request):
    def town_features(config=None, frames=240, route=0, **options):
        return small_town(frames, route)

    for module in (ob, feature_set, drives):
        monkeypatch.setattr(module, "town_features", town_features)
    monkeypatch.chdir(tmp_path)
    for whole, small in SMALLER.items():
        code = code.replace(whole, small)
    exec(compile(code, request.node.name, "exec"), {})


def test_files_named_in_the_documents_exist():
    root = PACKAGE.parent
    text = "".join(path.read_text() for path in (root / "README.md", *(root / "docs").glob("*.md")))
    named = re.findall(r"`((?:ovibjax|sweeps|examples|results|tests)/[\w/.]*)`", text)
    assert named and [name for name in named if not (root / name).exists()] == []


def test_every_size_that_is_made_smaller_is_in_an_example():
    for whole in SMALLER:
        assert any(whole in block.values[0] for block in BLOCKS), whole
