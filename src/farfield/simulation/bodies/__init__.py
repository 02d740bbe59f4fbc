"""What things are made of: triangle meshes, materials, vehicles, people, furniture."""
