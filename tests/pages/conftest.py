"""The small evaluation on made-up frames."""

from made_evaluation import camera, evaluation

__all__ = ["camera", "evaluation"]
