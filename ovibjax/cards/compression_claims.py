"""The paper's claims on compression and the project's expectations of the embedded town, by stated rules."""

from ovibjax.cards.compression_methods import FIXED, SPARSE_PREFIXES
from ovibjax.cards.compression_results import Results
from ovibjax.link.latency import JETSON, kbytes_per_s, semantic_latency_ms
from ovibjax.report.claims import HELD, NOT_HELD, REPORTED, Claim, above, below, interval

LINK_KB_PER_S = 8
PAPER_LATENCY_MS = {16: 42.0, 35: 52.0, 32: 50.4, 128: 100.6}
"""The paper's latency by prefix length at this throughput."""


def judge_claims(results: Results, embedded: bool) -> list[Claim]:
    """Claims on O-VIB and its rivals.

    Args:
        results: outcomes of all methods and seeds.
        embedded: whether the data are the embedded town.

    Returns:
        The claims, judged.
    """
    at = {k: interval(results.at("ovib", k)) for k in (16, 35, 128)}
    pca16 = results.at("pca", 16)
    ratio = interval(results.at("ovib", 16) / pca16)
    curve = results.mean_m("ovib")[:, 23:]
    spread = interval(100 * (curve.max(axis=1) / curve.min(axis=1) - 1))
    shorter = interval(results.at("ovib", 16) / results.at("ovib", 128))
    ours_16 = f"{at[16].text()} m against {interval(pca16).text('m')}, ratio {ratio.text()}"
    claims = [
        Claim(
            "A 16-float prefix localizes about as well as all 128: error at k = 16 at most 1.15 of that at k = 128",
            "9.31 / 10.11 m = 0.92",
            f"{at[16].text()} / {at[128].text('m')}, ratio {shorter.text()}",
            below(shorter, 1.15),
            "interval of the paired ratio at most 1.15",
        ),
        Claim(
            "O-VIB at k = 16 has at most half of PCA's error at k = 16",
            "-",
            ours_16,
            below(ratio, 0.5),
            "interval of the paired ratio at most 0.5",
        ),
    ]
    best_pca = min(SPARSE_PREFIXES, key=lambda k: results.at("pca", k).mean())
    crossing = [k for k in SPARSE_PREFIXES if results.at("pca", k).mean() < results.at("ovib", k).mean()]
    ahead = max((k for k in SPARSE_PREFIXES if k not in crossing), default=0)
    claims.append(
        Claim(
            "At every payload O-VIB is at least as accurate as PCA",
            "-",
            f"O-VIB is ahead up to k = {ahead}; PCA reaches "
            f"{interval(results.at('pca', best_pca)).text('m')} at k = {best_pca}",
            NOT_HELD if crossing else HELD,
            "no prefix at which PCA's mean error is lower",
        )
    )
    recoded = [interval(results.at(m, 16, recoded=True)) for m in ("ovib", "pca")]
    claims.append(
        Claim(
            "What a re-coded database changes: references passed through the same code and prefix as the query, k = 16",
            "-",
            f"O-VIB {recoded[0].text('m')}, PCA {recoded[1].text('m')}",
            REPORTED,
            "not part of the frozen-localizer protocol",
        )
    )
    difference = interval(results.at("vib", 35) - results.at("ovib", 35))
    claims.append(
        Claim(
            "Orthogonality helps: O-VIB below plain VIB at k = 35 (paired over seeds)",
            "9.30 - 8.75 = 0.55 m",
            f"VIB minus O-VIB {difference.text('m')}",
            HELD if difference.low > 0 else NOT_HELD,
            "the whole interval of the paired difference above zero",
        )
    )
    for k in FIXED:
        gap = interval(results.at("ovib", k) - results.at(f"fixed_{k}", k))
        claims.append(
            Claim(
                f"One scalable model replaces the fixed-rate model of K = {k}: at most 1 m worse at the same payload",
                "-",
                f"O-VIB minus fixed-rate {gap.text('m')}",
                below(gap, 1.0),
                "interval of the paired difference at most 1 m",
            )
        )
    span = [float(semantic_latency_ms(JETSON, k, kbytes_per_s(LINK_KB_PER_S))) for k in PAPER_LATENCY_MS]
    paper = list(PAPER_LATENCY_MS.values())
    claims.append(
        Claim(
            "Latency at 8 KB/s under the Jetson profile (k = 16, 35, 32, 128); the profile is read off its table, "
            "so this checks the payload and link arithmetic and measures nothing",
            " / ".join(map(str, paper)) + " ms",
            " / ".join(f"{ms:.1f}" for ms in span) + " ms",
            HELD if max(abs(a - b) for a, b in zip(span, paper, strict=True)) <= 0.1 else NOT_HELD,
            "each within 0.1 ms",
        )
    )
    if not embedded:
        return claims
    front_m, sides_m = (interval(results.raw_mode_m[mode]) for mode in ("F", "FS"))
    front = interval(results.raw_mode_m["F"] / results.raw_mode_m["FS"])
    expected = "expectation of the embedded town"
    return [
        *claims,
        Claim("Error at k = 16 at most 6 m", "9.31 m", at[16].text("m"), below(at[16], 6.0), expected),
        Claim("Error at k = 35 at most 6 m", "9.18 m", at[35].text("m"), below(at[35], 6.0), expected),
        Claim(
            "The error curve is flat within 15 % from k = 24 to 128",
            "9.18 to 10.11 m",
            f"{curve.mean(axis=0).min():.2f} to {curve.mean(axis=0).max():.2f} m, per seed {spread.text('%', 1)}",
            below(spread, 15.0),
            "interval over seeds of the largest over the smallest mean error",
        ),
        Claim(
            "Validation selects a prefix between 12 and 48",
            "k = 35",
            f"k = {results.chosen}",
            HELD if 12 <= results.chosen <= 48 else NOT_HELD,
            "shortest prefix within one standard error of the best, all seeds together",
        ),
        Claim(
            "Front-only has at least 3 times the error of front-plus-sides on raw features",
            "-",
            f"{front_m.text()} m / {sides_m.text()} m, ratio {front.text()}",
            above(front, 3.0),
            "interval of the paired ratio at least 3",
        ),
    ]
