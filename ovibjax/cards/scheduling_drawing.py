"""How scheduling rules are written and drawn: names and colours."""

from ovibjax.report import figures as fig

NAMES = {"voi_lyapunov": "VOI-Lyapunov", "base_dpp": "Base-DPP", "maxweight": "MaxWeight", "edf": "EDF", "fifo": "FIFO"}
"""Rules as the paper writes them."""

COLOURS = {
    "voi_lyapunov": fig.BLUE,
    "base_dpp": fig.ORANGE,
    "maxweight": fig.GREEN,
    "edf": fig.PURPLE,
    "fifo": fig.GREY,
}
