"""Parameters of the observations: what each is, whom it belongs to and how observations answer to it."""
