"""Many scans onto each other in one adjustment, with targets and control: how well each is placed, and which err."""
