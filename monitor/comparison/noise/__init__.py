"""What a comparison errs by: stated of each place, learned where nothing changed, and how far errors agree."""
