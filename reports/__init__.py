"""What a comparison says, shown and handed over; computes nothing.

`document.gather_facts` gathers it from a project, `report.write_report` makes a page and a document of it, `exports`
writes difference models, surfaces and tables as files that other programs read, `archive` all of a project for decades.
"""
