"""Results as one page that opens from disk: report.html, with video, a hand in 3D, angles over time and tables."""

from torchhand.report.document import write_report
from torchhand.report.facts import doubts
from torchhand.report.result import Result, load_result

__all__ = ["Result", "doubts", "load_result", "write_report"]
