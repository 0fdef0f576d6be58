"""Reports of a fit for people: an HTML page with tables and pictures, and a single picture."""

from petalfit.report.page import write_report as write_report
from petalfit.report.picture import write_picture as write_picture
