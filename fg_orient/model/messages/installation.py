"""Messages about the installation: what stands in place of the package ``factors``, the cache of kernels."""

from __future__ import annotations

from typing import Final

from fg_orient.model.messages.entry import words

WORDS: Final = words("""
installation.overwritten: this file of fg_orient was overwritten by the distribution {owner}, which has a package
    'factors' too
    -> pip uninstall {name}, and then pip install --force-reinstall --no-deps {source}, in this order; an
       environment has room for one of the two
installation.shared (warning): the distribution {owner} has this file too, and takes it along when it is updated or
    uninstalled
    -> pip uninstall {name}, and then pip install --force-reinstall --no-deps {source}, in this order
installation.damaged: this file of fg_orient is missing or changed, as after an uninstalled package 'factors'
    -> pip install --force-reinstall --no-deps {source}
installation.damaged_tree: this file of fg_orient's source tree is missing or changed
    -> restore it from the repository (git checkout factors), or install again from it
installation.other_version: this package 'factors' is of fg_orient {other}, the rest is of {version}
    -> pip install --force-reinstall --no-deps {source}
installation.other_distribution: the package 'factors' of the distribution {owner} hides the one of fg_orient in
    {ours}
    -> pip uninstall {name}, or install fg-orient into an environment of its own
installation.on_pythonpath: this hides the package 'factors' of fg_orient in {ours}, for its folder is in PYTHONPATH
    -> take {root} off PYTHONPATH, or rename it
installation.user_file: this file hides the package 'factors' of fg_orient in {ours}
    -> rename the file to a name that no package has, such as {new}
installation.user_folder: this folder hides the package 'factors' of fg_orient in {ours}
    -> rename or remove the folder, or start Python where it is not on the search path
installation.no_cache (warning): there is no place to keep compiled kernels, so that every start compiles them again
    -> set NUMBA_CACHE_DIR to a folder of yours that can be written to
installation.cache_open (warning): others can change the compiled kernels in {folder} ({why}); its files hold
    pickled code, which is run
    -> remove what lies there and take the right to write from others (chmod -R go-w), or set NUMBA_CACHE_DIR to a
       folder of yours
installation.proj_variable (warning): is set to {folder}: PROJ may read the data of another installation
    -> unset it
""")
