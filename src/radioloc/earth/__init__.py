"""Earth: stations and their catalogue, orientation, displacements of the crust, the atmosphere."""
