"""md.grade: which laws a student's own step or force function obeys, and what is wrong with it."""

from minimd.grade.findings import Finding, Grade
from minimd.grade.grading import grade
from minimd.grade.telling import laws_of

__all__ = ["Finding", "Grade", "grade", "laws_of"]
