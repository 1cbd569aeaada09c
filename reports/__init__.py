"""What a comparison says, shown and handed over; computes nothing.

`document.gather_facts` gathers it from a project, `html.write_report` makes one page of it, `exports` writes difference
models, surfaces and tables as files that other programs read.
"""
