"""Scenes drawn at random from nearly the whole schema, each solved and checked by what is known of it: `make stability RANDOM=300`.

python -m random_scenes 300 --seed 1    # with tests/ on the path
"""
