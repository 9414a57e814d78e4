"""The doctor: what is odd about an installation, a robot folder or a measurement log.

It refuses nothing that other commands accept and repairs nothing: it looks at everything at once and says in sentences
what will matter later, and what to do about it. What cannot be read at all ends as it does everywhere, with one line.
"""

from __future__ import annotations

from compplan.cli.doctor.installation import Remark, examine_installation
from compplan.cli.doctor.log import examine_log
from compplan.cli.doctor.robot_folder import examine_robot

__all__ = ["Remark", "examine_installation", "examine_log", "examine_robot"]
