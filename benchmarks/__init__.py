"""What accuracy costs in time, what each effect costs, and speed and memory against peers. Each
file is a script."""
