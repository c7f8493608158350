"""The paper's claims on compression and the project's expectations of the embedded town, by stated rules."""

from ovibjax.cards.compression_methods import SPARSE_PREFIXES
from ovibjax.cards.compression_results import Results
from ovibjax.cards.deployment_overhead import LINK_KB_PER_S, PAPER_LATENCY_MS
from ovibjax.link.latency import JETSON, kbytes_per_s, semantic_latency_ms
from ovibjax.report.claims import Claim, interval


def compression_claims(results: Results, embedded: bool) -> list[Claim]:
    """Claims on O-VIB and its rivals.

    Args:
        results: outcomes of all methods and seeds.
        embedded: whether the data are the embedded town.

    Returns:
        The claims, judged.
    """
    return [
        _short_prefix(results),
        *_against_pca(results),
        *([_orthogonality(results)] if "vib" in results.judged else []),
        *(_one_model(results, k) for k in results.fixed),
        _latency(),
        *(_town(results) if embedded else []),
    ]


def _short_prefix(results: Results) -> Claim:
    short, whole = results.at("ovib", 16), results.at("ovib", 128)
    return Claim.at_most(
        "A 16-float prefix localizes about as well as all 128: error at k = 16 at most 1.15 of that at k = 128",
        "9.31 / 10.11 m = 0.92",
        f"{interval(short).text()} / {interval(whole).text('m')}, ratio {interval(short / whole).text()}",
        1.15,
        short / whole,
        rule="interval of the paired ratio at most 1.15; the margin is ours",
    )


def _against_pca(results: Results) -> list[Claim]:
    ovib, pca = results.at("ovib", 16), results.at("pca", 16)
    gains = {k: results.at("pca", k) - results.at("ovib", k) for k in SPARSE_PREFIXES}
    behind = [f"k = {k} ({interval(-gain).text('m')})" for k, gain in gains.items() if gain.mean() < 0]
    decoder = {k: interval(results.at("pca_completed", k) - results.at("ovib", k)).text() for k in (8, 16, 35, 128)}
    recoded = [interval(results.recoded_at(method, 16)).text("m") for method in ("ovib", "pca")]
    both_coded = {k: interval(results.recoded_at("pca", k) - results.recoded_at("ovib", k)).text() for k in decoder}
    return [
        Claim.ratio_at_most(
            "O-VIB at k = 16 has at most half of PCA's error at k = 16",
            "-",
            f"{interval(ovib).text()} m against {interval(pca).text('m')}, ratio {interval(ovib / pca).text()}",
            0.5,
            ovib,
            pca,
        ).as_own(),
        Claim.at_least(
            "At every payload O-VIB is at least as accurate as PCA",
            "-",
            f"O-VIB has the larger mean error at {', '.join(behind) or 'no prefix'}",
            0.0,
            *gains.values(),
            rule=f"paired interval of PCA's error minus O-VIB's not below zero at any of {len(gains)} prefixes",
        ).as_own(),
        Claim.reported(
            "What the encoder gives beyond the decoder: PCA's code with the completing decoder and a localizer trained "
            f"on it, error minus O-VIB's at k = {', '.join(map(str, decoder))}",
            "-",
            ", ".join(decoder.values()) + " m",
            "paired over seeds; above zero where a learned code is better than PCA's",
        ).as_own(),
        Claim.reported(
            "What a re-coded database changes: references passed through the same code and prefix as the query",
            "-",
            f"k = 16: O-VIB {recoded[0]}, PCA {recoded[1]}; PCA minus O-VIB at k = {', '.join(map(str, decoder))}: "
            f"{', '.join(both_coded.values())} m",
            "not part of the frozen-localizer protocol",
        ).as_own(),
    ]


def _orthogonality(results: Results) -> Claim:
    ovib, vib = results.at("ovib", 35), results.at("vib", 35)
    return Claim.less(
        "Orthogonality helps: O-VIB below plain VIB at k = 35 (paired over seeds)",
        "9.30 - 8.75 = 0.55 m",
        f"VIB minus O-VIB {interval(vib - ovib).text('m')}",
        ovib,
        vib,
        strict=True,
    )


def _one_model(results: Results, k: int) -> Claim:
    worse = results.at("ovib", k) - results.at(f"fixed_{k}", k)
    return Claim.at_most(
        f"One scalable model replaces the fixed-rate model of K = {k}: at most 1 m worse at the same payload",
        "-",
        f"O-VIB minus fixed-rate {interval(worse).text('m')}",
        1.0,
        worse,
        rule="interval of the paired difference at most 1 m",
    ).as_own()


def _latency() -> Claim:
    rate_bps = kbytes_per_s(LINK_KB_PER_S)
    ours = [float(semantic_latency_ms(JETSON, k, rate_bps)) for k in PAPER_LATENCY_MS]
    return Claim.reported(
        "Latency at 8 KB/s under the Jetson profile (k = 16, 35, 32, 128)",
        " / ".join(map(str, PAPER_LATENCY_MS.values())) + " ms",
        " / ".join(f"{ms:.1f}" for ms in ours) + " ms",
        "the profile is read off the paper's table, so that equality is no finding",
    )


def _town(results: Results) -> list[Claim]:
    """What is expected of the embedded town."""
    curve = results.mean_m("ovib")[:, 23:]
    spread = 100 * (curve.max(axis=1) / curve.min(axis=1) - 1)
    flat = curve.mean(axis=0)
    front, sides = results.raw_mode_m["F"], results.raw_mode_m["FS"]
    errors_m = {16: results.at("ovib", 16), 35: results.at("ovib", 35)}
    paper, rule = {16: "9.31 m", 35: "9.18 m"}, "expectation of the embedded town"
    expected = [
        *(
            Claim.at_most(f"Error at k = {k} at most 6 m", paper[k], interval(e).text("m"), 6.0, e, rule=rule)
            for k, e in errors_m.items()
        ),
        Claim.at_most(
            "The error curve is flat within 15 % from k = 24 to 128",
            "9.18 to 10.11 m",
            f"{flat.min():.2f} to {flat.max():.2f} m, per seed {interval(spread).text('%', 1)}",
            15.0,
            spread,
            rule="interval over seeds of the largest over the smallest mean error",
        ),
        Claim.true(
            "Validation selects a prefix between 12 and 48",
            "k = 35",
            f"k = {results.chosen}",
            12 <= results.chosen <= 48,
            "shortest prefix within one standard error of the best, all seeds together",
        ),
        Claim.ratio_at_least(
            "Front-only has at least 3 times the error of front-plus-sides on raw features",
            "-",
            f"{interval(front).text()} m / {interval(sides).text('m')}, ratio {interval(front / sides).text()}",
            3.0,
            front,
            sides,
        ),
    ]
    return [claim.as_own() for claim in expected]
