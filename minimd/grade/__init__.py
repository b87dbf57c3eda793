"""md.grade: which laws a student's own step or force function obeys, and what is wrong with it."""

from minimd.grade.findings import Finding, Grade
from minimd.grade.grading import grade

__all__ = ["Finding", "Grade", "grade"]
