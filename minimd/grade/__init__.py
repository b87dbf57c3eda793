"""What a student's own step or force function keeps, and what is wrong with it: md.grade."""

from minimd.grade.findings import Finding, Grade
from minimd.grade.grading import grade

__all__ = ["Finding", "Grade", "grade"]
