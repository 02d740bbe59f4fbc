"""The measuring cars, a file each; a new one is entered in :data:`farfield.simulation.rig.RIGS`."""
