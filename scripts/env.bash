# Source this in bash after scripts/setup: the shell then finds .venv's Python, and jpap_ros and jpap_msgs.
_jpap_root="$(cd "$(dirname "${BASH_SOURCE[0]}")/.." && pwd)"
unset AMENT_PREFIX_PATH COLCON_PREFIX_PATH CMAKE_PREFIX_PATH PYTHONPATH _ROS_WHEELS_BOOTSTRAP_COMPLETE
# The setup files read variables that may be unset.
_jpap_flags=$-; set +u
source "$_jpap_root/.venv/bin/activate"
source "$_jpap_root/install/setup.bash"
case $_jpap_flags in *u*) set -u ;; esac
unset _jpap_root _jpap_flags
