"""`python -m motionkit`: the command line, as torchrun and interpreters without the installed script start it."""

from motionkit.cli.start import main

if __name__ == "__main__":
    main()
