"""A fit for people: a page with tables and pictures, and a picture alone."""

from petalfit.report.page import write_report as write_report
from petalfit.report.picture import write_picture as write_picture
