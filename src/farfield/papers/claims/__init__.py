"""The papers' claims, declared before anything is run: what is compared, in which metric, by which margin.

claims = load("cirrus")
claims["C1"].comparisons[0].published("dds")       # 0.0772: what the paper's table says
claims.sha256                                      # stands on the page beside every decision
"""

from farfield.papers.claims.schema import CLAIMS, Claim, ClaimRun, Claims, ClaimSide, Comparison, Metric, load

__all__ = ["CLAIMS", "Claim", "ClaimRun", "ClaimSide", "Claims", "Comparison", "Metric", "load"]
