"""python -m minimd: the command."""

from minimd_command import main

if __name__ == "__main__":
    main()
