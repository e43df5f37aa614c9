"""What readers of every format share: files, tables of numbers, clocks, units and axes."""
