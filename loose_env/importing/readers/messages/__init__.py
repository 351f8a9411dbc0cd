"""Messages of topics: MCAP files and ROS 2 bags.

Data flow: field_path -> mcap_messages -> mcap_records -> mcap_file -> sqlite_records -> rosbag2.
"""
