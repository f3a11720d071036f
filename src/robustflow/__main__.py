"""`python -m robustflow`, which `torchrun -m robustflow` needs."""

from .cli.main import main

main()
