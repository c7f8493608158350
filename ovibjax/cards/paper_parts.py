"""Which part of the paper each figure is about, in the paper's order."""

PARTS: dict[str, tuple[str, ...]] = {
    "Set-up": ("setup",),
    "Scalable compression": ("scalable_compression", "encoder_ablation", "single_scene_ib"),
    "Coarse-to-fine retrieval": ("retrieval",),
    "Request control": ("voi_predictor", "request_control", "view_rate_selection", "voi_timing"),
    "Multi-client scheduling": ("multi_client", "weights", "theorem"),
    "Real-scene evaluation": ("real_scene",),
    "The parts together": ("walkthrough", "system_grid"),
    "Beyond the paper": ("bytes", "live", "adaptation"),
}
"""Figures by section of the paper; the last two parts are ours."""

ABOUT = (
    "ovibjax implements “Task-Oriented Communications for Edge-Assisted Multi-View Localization” and measures every "
    "figure of it again, on towns and rooms that it renders itself. What the paper claims stands beside what was "
    "measured here, with intervals, whether it holds or not.",
    "The paper's numbers come from CARLA towns, motion capture and a Jetson Orin NX: in another world metres do not "
    "compare, orderings do.",
)
"""What the page of results says of itself."""
