"""RTN and RTNH, the 4D radar networks of K-Radar (Paek, Kong and Wijaya, NeurIPS 2022)."""
