"""Episodes to and from data sets of other libraries, a module each that imports its library."""
