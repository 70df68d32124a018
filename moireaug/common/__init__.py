"""What every room uses: checks, numbers, files, networks."""
