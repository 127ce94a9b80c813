"""Where people find operators beside the sidebar: menus, shortcuts, the pie, the manual."""
