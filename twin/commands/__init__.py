"""One module per command: read the inputs, compute, write the outputs, return a result that prints itself."""
