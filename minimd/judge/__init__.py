"""md.grade: which laws a student's own step or force function obeys, and what is wrong with it."""

from minimd.judge.findings import Finding, Grade
from minimd.judge.grading import grade
from minimd.judge.telling import laws_of

__all__ = ["Finding", "Grade", "grade", "laws_of"]
