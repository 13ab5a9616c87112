"""The page a person reads: report.json and report.html."""
